//! `sdfarm verify`: says whether a picture is what its job makes, by rendering it again on this machine.

mod find;
mod words;

use std::path::Path;

use anyhow::Context;
use clap::Args;
use helper::verify::{Checked, Extent, Original, draw, unreadable};
use proto::verify::{Comparison, Maker, Verification, probability_to_find, tiles_found_surely};
use proto::{Client, rounding};
use scene::PICTURE_VERSION;
use worker::image::stored::{FoundProvenance, StoredPicture, UnreadablePicture};
use worker::{CancelFlag, Renderer};

use self::find::{Candidate, VerifiedPicture};
use crate::arguments::{RendererArguments, ServerArguments};
use crate::error::{PictureDiffers, UsageError};
use crate::output_file::OutputFile;
use crate::overrides::OverrideArguments;
use crate::terminal::{print_line, print_note};

/// Arguments of `verify`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The picture: a file (PNG or EXR), or a job of the farm: its id, a part of it, its name, or latest.
    #[arg(value_name = "FILE|JOB")]
    picture: String,
    /// Job file that the picture should be of, instead of a job of the farm.
    #[arg(long, value_name = "FILE", env = "SDFARM_JOB")]
    job: Option<String>,
    #[command(flatten)]
    overrides: OverrideArguments,
    /// Frame number, from 0 [default: the one that the file names].
    #[arg(long, value_name = "N", env = "SDFARM_FRAME")]
    frame: Option<u32>,
    /// Number of tiles of 64×64 pixels that are rendered again, chosen at random.
    #[arg(long, value_name = "N", env = "SDFARM_TILES", default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..))]
    tiles: u32,
    /// Render the whole picture again.
    #[arg(long, env = "SDFARM_ALL", conflicts_with = "tiles", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    all: bool,
    /// File for a picture that marks the differences, a PNG; - for standard output.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT")]
    output: Option<String>,
    #[command(flatten)]
    server: ServerArguments,
    #[command(flatten)]
    renderer: RendererArguments,
    /// Print the result as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Verifies the picture; fails with exit code 1 if it differs.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let source = find::source(&arguments).await?;
    let renderer = arguments.renderer.renderer()?;
    // Rendering blocks its thread; an interrupt ends the process meanwhile.
    let checked = {
        let extent = if arguments.all { Extent::All } else { Extent::Sample(arguments.tiles) };
        tokio::task::spawn_blocking(move || Outcome::of(source, extent, &*renderer))
            .await
            .context("the verification was interrupted")??
    };
    let made_by = match (&checked.client, checked.candidate.id) {
        (Some(client), Some(id)) => makers(client, id, checked.frame).await,
        _ => None,
    };
    if let (Some(path), Some(stored)) = (&arguments.output, &checked.stored) {
        let mut output = OutputFile::create(path)?;
        std::io::Write::write_all(output.file(), &draw(stored, &checked.checked)?)
            .with_context(|| format!("could not write {path}"))?;
        output.commit()?;
    }
    let result = checked.verification(made_by);
    let is_to_standard_output = arguments.output.as_deref() == Some("-");
    let print = |line: &str| {
        if is_to_standard_output {
            print_note(line);
            return Ok(());
        }
        print_line(line)
    };
    if arguments.json {
        print(&serde_json::to_string_pretty(&result)?)?;
    } else {
        let Outcome { name, candidate, checked, .. } = &checked;
        for line in words::lines(name, &candidate.origin, &checked.comparison, &result) {
            print(&line)?;
        }
    }
    if result.same { Ok(()) } else { Err(PictureDiffers.into()) }
}

/// Workers that made a frame; `None` if the server does not say.
async fn makers(client: &Client, id: proto::JobId, frame: u32) -> Option<Vec<Maker>> {
    match client.verify(id, frame, 0).await {
        Ok(answer) => answer.made_by,
        Err(error) => {
            print_note(&format!("the server could not say who made it: {error}"));
            None
        }
    }
}

/// A verified picture.
struct Outcome {
    name: String,
    frame: u32,
    client: Option<Client>,
    candidate: Candidate,
    checked: Checked,
    stored: Option<StoredPicture>,
}

impl Outcome {
    /// Verifies a picture.
    fn of(source: VerifiedPicture, extent: Extent, renderer: &dyn Renderer) -> anyhow::Result<Self> {
        let cancel = CancelFlag::new();
        let stored = StoredPicture::read(&source.file);
        if let Err(UnreadablePicture::NotAPicture) = stored {
            return Err(UsageError(format!(
                "{} is neither a PNG nor an EXR: give a picture, or a job of the farm",
                source.name
            ))
            .into());
        }
        if let Ok(StoredPicture { provenance: FoundProvenance::Known(found), .. }) = &stored
            && found.picture_version != PICTURE_VERSION
        {
            return Err(UsageError(format!(
                "{} says that it was made with picture version {}, and this sdfarm {} makes version {PICTURE_VERSION}: \
                 their pixels may differ, so rendering it again proves nothing; use a release with that version",
                source.name,
                found.picture_version,
                env!("CARGO_PKG_VERSION")
            ))
            .into());
        }
        let VerifiedPicture { name, file, frame, mut jobs, client } = source;
        let closest = match &stored {
            Ok(stored) if jobs.len() > 1 => closest(&jobs, frame, &file, stored, renderer, &cancel)?,
            Ok(_) | Err(_) => 0,
        };
        let candidate = jobs.swap_remove(closest);
        let original = Original::new(&candidate.job, frame)?;
        let (checked, stored) = match stored {
            Ok(stored) => (original.check(&file, stored.clone(), extent, renderer, None, &cancel)?, Some(stored)),
            Err(error) => (unreadable(&original, &error), None),
        };
        Ok(Self { name, frame, client, candidate, checked, stored })
    }

    fn verification(&self, made_by: Option<Vec<Maker>>) -> Verification {
        let Comparison { tiles_checked, tiles_total, pixels_different, differs, findings, .. } =
            &self.checked.comparison;
        Verification {
            same: self.checked.comparison.is_same(),
            tiles_checked: *tiles_checked,
            tiles_total: *tiles_total,
            finds_one_tile: rounding::fraction(probability_to_find(*tiles_checked, *tiles_total, 1)),
            finds_tiles: tiles_found_surely(*tiles_checked, *tiles_total),
            pixels_different: *pixels_different,
            differs: differs.clone(),
            findings: findings.clone(),
            made_by,
            picture_version: PICTURE_VERSION,
            scene: self.checked.comparison.scene.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }
}

/// The job that a picture is of, among those that could be: the one with the fewest different pixels in a small sample.
/// Jobs of one scene that differ only in their samples or their exposure make files that say the same of themselves.
fn closest(
    jobs: &[Candidate],
    frame: u32,
    file: &[u8],
    stored: &StoredPicture,
    renderer: &dyn Renderer,
    cancel: &CancelFlag,
) -> anyhow::Result<usize> {
    /// Tiles of the small sample.
    const TILES: u32 = 2;
    let mut best = (u64::MAX, 0);
    for (index, candidate) in jobs.iter().enumerate() {
        let original = Original::new(&candidate.job, frame)?;
        let sample = original.check(file, stored.clone(), Extent::Sample(TILES), renderer, None, cancel)?.comparison;
        // Of a picture of another size, no tile is compared.
        if sample.tiles_checked > 0 && sample.pixels_different < best.0 {
            best = (sample.pixels_different, index);
        }
    }
    Ok(best.1)
}

/// Whether a path names a file.
fn is_file(path: &str) -> bool {
    path == "-" || Path::new(path).is_file()
}
