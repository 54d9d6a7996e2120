//! Verifies a picture: renders its tiles again, and compares every value of its file with what it should be.
//!
//! It never asks who made the picture, and believes nothing that the file says about itself.

mod marked;

use std::collections::HashSet;
use std::hash::{BuildHasher, RandomState};
use std::time::{Duration, Instant};

use anyhow::Context;
use proto::Rect;
use proto::tile::Tiling;
use proto::verify::{Comparison, DifferingPixel, DifferingTile, MAX_LISTED, TILE_PX};
use scene::Job;
use worker::image::stored::{ChannelValues, FoundProvenance, StoredPicture, UnreadablePicture, tile_values};
use worker::image::{PictureSpec, Provenance};
use worker::{CancelFlag, RenderError, Renderer, TileRequest};

use crate::attempt;

pub use marked::draw;

/// Tiles that are checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// All.
    All,
    /// This many, chosen at random.
    Sample(u32),
}

/// A job's frame, as it should be.
#[derive(Clone, Debug)]
pub struct Original<'a> {
    job: &'a Job,
    frame: u32,
    spec: PictureSpec,
}

/// Result of a verification, with the place of every difference.
#[derive(Debug, Default)]
pub struct Checked {
    /// The comparison.
    pub comparison: Comparison,
    /// Tiles that were rendered again.
    pub tiles: Vec<Rect>,
    /// Pixels that differ, as column and row: the first `MAX_MARKED`.
    pub pixels: Vec<[u32; 2]>,
    /// Top left corners of the tiles that differ.
    corners: HashSet<[u32; 2]>,
}

/// Maximum number of pixels that are marked.
const MAX_MARKED: usize = 1 << 20;

impl<'a> Original<'a> {
    /// The frame of a job.
    pub fn new(job: &'a Job, frame: u32) -> anyhow::Result<Self> {
        Ok(Self { job, frame, spec: PictureSpec::new(&job.at(frame)?) })
    }

    /// Provenance that its picture has.
    pub fn provenance(&self) -> &Provenance {
        &self.spec.provenance
    }

    /// How a picture's size or channels differ from its own.
    pub fn misfit(&self, stored: &StoredPicture) -> Option<String> {
        stored.misfit(&self.spec)
    }

    /// Compares a file that could be read with what it should be, until the time limit.
    pub fn check(
        &self,
        file: &[u8],
        stored: StoredPicture,
        extent: Extent,
        renderer: &dyn Renderer,
        limit: Option<Duration>,
        cancel: &CancelFlag,
    ) -> anyhow::Result<Checked> {
        let mut findings = self.check_provenance(&stored.provenance);
        let stored = stored.normalized(&self.spec);
        let all = proto::verify::tiles(self.spec.width, self.spec.height);
        let mut checked = Checked::default();
        checked.comparison.scene = Some(self.provenance().scene.clone());
        checked.comparison.tiles_total = u32::try_from(all.len()).context("a picture has fewer tiles")?;
        if let Some(misfit) = self.misfit(&stored) {
            // Nothing of it can be compared, so all of it is wrong.
            findings.push(misfit);
            checked.comparison.findings = findings;
            return Ok(checked);
        }
        let is_rewritten = stored.rewrite(&self.spec)? == file;
        let rects = match extent {
            Extent::All => self.render_tiles(),
            Extent::Sample(count) => choose(all, count as usize),
        };
        let start = Instant::now();
        let is_late = || limit.is_some_and(|limit| start.elapsed() >= limit);
        attempt::limited(cancel, limit, || {
            for rect in rects {
                let request = TileRequest { job: self.job, frame: self.frame, rect: self.spec.rendered_for(rect) };
                match renderer.render(&request, cancel, &|_| ()) {
                    Ok(tile) => {
                        let tile = self.spec.finished_tile(tile, rect);
                        compare(&stored, &tile_values(&self.spec, &tile)?, rect, &mut checked);
                    }
                    Err(RenderError::Cancelled) if is_late() && !checked.tiles.is_empty() => break,
                    Err(RenderError::Cancelled) => anyhow::bail!("not even one tile was rendered in time"),
                    Err(other) => return Err(other.into()),
                }
                checked.tiles.push(rect);
            }
            Ok(())
        })?;
        let pixels_same = checked.pixels.is_empty();
        checked.comparison.tiles_checked = match extent {
            Extent::All => checked.comparison.tiles_total,
            Extent::Sample(_) => u32::try_from(checked.tiles.len()).unwrap_or(u32::MAX),
        };
        if pixels_same && !is_rewritten && findings.is_empty() {
            findings.push(
                "the checked pixels are the same, but not the bytes: another program encoded it again, or changed its metadata"
                    .to_owned(),
            );
        }
        checked.comparison.differs.sort_by_key(|tile| (tile.y, tile.x));
        checked.comparison.tiles_different = u32::try_from(checked.corners.len()).unwrap_or(u32::MAX);
        checked.comparison.pixels_same = pixels_same;
        checked.comparison.encoding_same = is_rewritten;
        checked.comparison.findings = findings;
        Ok(checked)
    }

    /// Tiles as a farm renders them: they cover the picture, and are large, so that little is prepared again.
    fn render_tiles(&self) -> Vec<Rect> {
        let (image, film) = (&self.job.image, self.job.image.film());
        let (width, height, samples) = (film.width, film.height, image.samples.max());
        Tiling { width, height, samples, pixel_bytes: film.pixel_bytes(), tile_edge: None }.tiles()
    }

    /// Faults of a provenance, in words.
    fn check_provenance(&self, found: &FoundProvenance) -> Vec<String> {
        let wanted = self.provenance();
        let found = match found {
            FoundProvenance::Missing => return vec!["it has no provenance: its metadata was removed".to_owned()],
            FoundProvenance::Unreadable => {
                return vec!["its provenance cannot be read: its metadata was changed".to_owned()];
            }
            FoundProvenance::Known(found) => found,
        };
        let mut wrong = Vec::new();
        let mut compare = |name: &str, found: &dyn std::fmt::Display, wanted: &dyn std::fmt::Display| {
            let (found, wanted) = (found.to_string(), wanted.to_string());
            if found != wanted {
                wrong.push(format!("its provenance says {name} {found}, but this job's is {wanted}"));
            }
        };
        compare("scene", &found.scene.escape_debug(), &wanted.scene);
        compare("frame", &found.frame, &wanted.frame);
        compare("seed", &found.seed, &wanted.seed);
        compare("picture version", &found.picture_version, &wanted.picture_version);
        if wrong.is_empty() && found.objects != wanted.objects {
            wrong.push("its provenance has other names of objects than this job".to_owned());
        }
        wrong
    }
}

/// A picture that cannot be read, compared with a frame: nothing of it is known.
pub fn unreadable(original: &Original<'_>, error: &UnreadablePicture) -> Checked {
    let total = proto::verify::tiles(original.spec.width, original.spec.height).len();
    let comparison = Comparison {
        tiles_total: u32::try_from(total).unwrap_or(u32::MAX),
        findings: vec![error.to_string()],
        scene: Some(original.provenance().scene.clone()),
        ..Comparison::default()
    };
    Checked { comparison, ..Checked::default() }
}

/// Compares the values of a rectangle.
fn compare(stored: &StoredPicture, wanted: &[ChannelValues], rect: Rect, checked: &mut Checked) {
    let mut index = 0;
    for y in rect.y..rect.y + rect.height {
        for x in rect.x..rect.x + rect.width {
            let at = y as usize * stored.width as usize + x as usize;
            let mut channels = stored.channels.iter().zip(wanted);
            let differing = channels.find(|(found, wanted)| found.values.bits(at) != wanted.values.bits(index));
            if let Some((found, wanted)) = differing {
                let number = |channel: &ChannelValues, index: usize| {
                    Some(channel.kind.number(channel.values.bits(index))).filter(|number| number.is_finite())
                };
                let (value, expected) = (number(found, at), number(wanted, index));
                let pixel = DifferingPixel { x, y, channel: found.name.clone(), value, expected };
                add(pixel, [stored.width, stored.height], checked);
            }
            index += 1;
        }
    }
}

/// Counts a pixel that differs.
fn add(pixel: DifferingPixel, [width, height]: [u32; 2], checked: &mut Checked) {
    let Checked { comparison, pixels, corners, .. } = checked;
    let (x, y) = (pixel.x / TILE_PX * TILE_PX, pixel.y / TILE_PX * TILE_PX);
    if pixels.len() < MAX_MARKED {
        pixels.push([pixel.x, pixel.y]);
    }
    comparison.pixels_different += 1;
    if corners.insert([x, y]) && comparison.differs.len() < MAX_LISTED {
        let (width, height) = (TILE_PX.min(width - x), TILE_PX.min(height - y));
        comparison.differs.push(DifferingTile { x, y, width, height, pixels: 1, first: pixel });
    } else if let Some(tile) = comparison.differs.iter_mut().find(|tile| (tile.x, tile.y) == (x, y)) {
        tile.pixels += 1;
    }
}

/// Chooses `count` of these tiles. Who makes a picture cannot know which: the order is from the system's random numbers.
fn choose(mut tiles: Vec<Rect>, count: usize) -> Vec<Rect> {
    if count < tiles.len() {
        let keyed = RandomState::new();
        tiles.sort_by_cached_key(|tile| keyed.hash_one(tile));
        tiles.truncate(count);
    }
    tiles
}

#[cfg(test)]
mod tests;
