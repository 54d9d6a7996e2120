//! Says the result of a verification in words.

use proto::verify::{Comparison, DifferingTile, Maker, Verification};

use crate::counted::counted;
use crate::terminal::escape_line;

/// Maximum number of tiles that are listed.
const MAX_TILES: usize = 8;
/// Maximum number of workers that are named.
const MAX_WORKERS: usize = 5;

/// Lines for users.
pub(super) fn lines(name: &str, origin: &str, comparison: &Comparison, result: &Verification) -> Vec<String> {
    let mut lines = vec![if comparison.is_same() {
        format!("{name}: the same bytes as {origin} makes{}", extent(result))
    } else if comparison.pixels_same {
        format!("{name}: NOT the bytes that {origin} makes, though every checked pixel is the same{}", extent(result))
    } else if comparison.pixels_different > 0 {
        format!(
            "{name}: NOT the picture that {origin} makes: {} in {} of the {} differ",
            counted(comparison.pixels_different, "pixel"),
            comparison.tiles_different,
            counted(comparison.tiles_checked, "checked tile")
        )
    } else {
        format!("{name}: NOT the picture that {origin} makes")
    }];
    lines.extend(comparison.findings.iter().map(|finding| format!("  {}", escape_line(finding))));
    for tile in result.differs.iter().take(MAX_TILES) {
        lines.push(format!("  {}", different(tile, result.made_by.as_deref())));
    }
    if comparison.tiles_different as usize > MAX_TILES {
        lines
            .push(format!("  and {}", counted(u64::from(comparison.tiles_different) - MAX_TILES as u64, "other tile")));
    }
    if comparison.pixels_same && result.tiles_checked < result.tiles_total {
        lines.push(format!("  {}", proof(result)));
    }
    lines.push(format!("  {}", made_by(result.made_by.as_deref())));
    lines.push(format!(
        "  scene {}, picture version {}, rendered again by sdfarm {}",
        result.scene.as_deref().unwrap_or_default(),
        result.picture_version,
        result.version
    ));
    lines
}

fn extent(result: &Verification) -> String {
    if result.tiles_checked == result.tiles_total {
        " (all of it was rendered again)".to_owned()
    } else {
        format!(" ({} of {} were rendered again)", result.tiles_checked, counted(result.tiles_total, "tile"))
    }
}

/// Proof that a sample is, in words.
fn proof(result: &Verification) -> String {
    format!(
        "a sample proves little: a change in one tile is found with a chance of {:.0} %, and with 95 % or more if it is \
         in {}; --all checks every pixel",
        100.0 * result.finds_one_tile,
        counted(result.finds_tiles, "tile")
    )
}

fn different(tile: &DifferingTile, made_by: Option<&[Maker]>) -> String {
    let number = |value: Option<f64>| value.map_or_else(|| "not a number".to_owned(), |value| value.to_string());
    let DifferingTile { x, y, width, height, pixels, first } = tile;
    let by: Vec<_> = made_by.into_iter().flatten().filter(|maker| maker.touches(tile)).map(name).collect();
    let by = if by.is_empty() { String::new() } else { format!(", rendered by {}", by.join(", ")) };
    format!(
        "tile {width}×{height} at ({x}, {y}): {}; at ({}, {}), {} is {} and should be {}{by}",
        counted(*pixels, "pixel"),
        first.x,
        first.y,
        escape_line(&first.channel),
        number(first.value),
        number(first.expected)
    )
}

fn name(maker: &Maker) -> String {
    format!("{} ({})", escape_line(&maker.worker), escape_line(&maker.device))
}

fn made_by(makers: Option<&[Maker]>) -> String {
    match makers {
        None | Some([]) => {
            "who made it is not known: no farm was asked, or its database does not know any more".to_owned()
        }
        Some(makers) => {
            let mut names: Vec<_> = makers.iter().take(MAX_WORKERS).map(name).collect();
            if makers.len() > MAX_WORKERS {
                names.push(counted((makers.len() - MAX_WORKERS) as u64, "other worker"));
            }
            format!("made by {}", names.join(", "))
        }
    }
}
