//! `sdfarm demo`: starts a temporary farm, renders one picture on it, and leaves only the picture.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use proto::Client;
use scene::{Format, Job};
use serde_json::Value;
use server::{Config, Server};
use tokio_util::sync::CancellationToken;

use crate::commands::serve::current_executable;
use crate::commands::temporary_farm_folder;
use crate::counted::counted;
use crate::error::UsageError;
use crate::output_file::{OutputFile, check_writable};
use crate::signals::Signals;
use crate::terminal::{print_line, print_note};
use crate::{follow, shipped};

/// Scene of a first picture: it shows every feature of the renderer.
const DEFAULT_SCENE: &str = "fjord";
/// Default width of its picture, in pixels: about 15 s on two cores.
const DEFAULT_WIDTH_PX: u32 = 800;
/// Narrowest and widest picture.
const WIDTHS_PX: std::ops::RangeInclusive<i64> = 16..=16_384;

/// Arguments of `demo`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Shipped scene to render.
    #[arg(long, value_name = "NAME", env = "SDFARM_SCENE", default_value = DEFAULT_SCENE)]
    scene: String,
    /// List the shipped scenes, and render none.
    #[arg(long, env = "SDFARM_LIST", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    list: bool,
    /// Width of the picture, in pixels; its height follows [default: 800 for fjord, otherwise the scene's width].
    #[arg(long, value_name = "PIXELS", env = "SDFARM_WIDTH", value_parser = clap::value_parser!(u32).range(WIDTHS_PX))]
    width: Option<u32>,
    /// Replace a file of the picture's name in the current folder.
    #[arg(long, env = "SDFARM_FORCE", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    force: bool,
}

/// Lists the scenes, or renders one on a temporary farm.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    if arguments.list {
        return print_line(&shipped::names().join("\n"));
    }
    let is_first = arguments.scene == DEFAULT_SCENE;
    let width = arguments.width.or(is_first.then_some(DEFAULT_WIDTH_PX));
    let text = sized(shipped::job_file(&arguments.scene)?, width)?;
    let job = scene::parse(&text).with_context(|| format!("the shipped scene {} is damaged", arguments.scene))?;
    // Checked before rendering, so that no rendered picture is lost.
    check_writable("./")?;
    let mut signals = Signals::install()?;

    let data = temporary_farm_folder()?;
    let config = Config {
        listen: ([127, 0, 0, 1], 0).into(),
        data: data.path().to_owned(),
        worker_program: current_executable()?,
        job_reader: Some(current_executable()?),
        ..Config::default()
    };
    let server = Server::start(config).await?;
    let client = Client::new(&format!("http://{}", server.address()))?;
    let film = job.image.film();
    print_note(&format!(
        "a farm serves {}; it renders {}: {}×{}, {}",
        client.server(),
        arguments.scene,
        film.width,
        film.height,
        counted(job.image.samples.max(), "sample")
    ));
    let start = Instant::now();

    let shutdown = CancellationToken::new();
    let serving = tokio::spawn(server.run(shutdown.clone()));
    let done = tokio::select! {
        done = picture(&client, text) => done,
        () = signals.next() => Err(anyhow::anyhow!("interrupted: nothing was saved")),
    };
    let took = start.elapsed();
    shutdown.cancel();
    serving.await.context("the farm did not shut down gracefully")??;
    let path = save(&done?, &arguments.scene, &job, arguments.force)?;
    print_line(&format!("saved {} after {:.1} s", path.display(), took.as_secs_f64()))?;
    print_note(&next_step());
    Ok(())
}

/// Scales the job's picture to this width, and keeps its aspect ratio.
fn sized(text: Vec<u8>, width: Option<u32>) -> anyhow::Result<Vec<u8>> {
    let Some(width) = width.map(u64::from) else { return Ok(text) };
    let mut job: Value = serde_json::from_slice(&text).context("a shipped scene is damaged")?;
    let image = &mut job["image"];
    if let (Some(old_width), Some(old_height)) = (image["width"].as_u64(), image["height"].as_u64()) {
        image["height"] = (old_height * width / old_width.max(1)).max(1).into();
        image["width"] = width.into();
    }
    Ok(serde_json::to_vec(&job)?)
}

/// Suggests the next commands after a first picture.
fn next_step() -> String {
    let program = std::env::args().next().unwrap_or_else(|| "sdfarm".to_owned());
    format!(
        "next: `{program} serve` runs a permanent farm; its page is http://127.0.0.1:8080, and `{program} open` shows it;\n\
         `{program} demo --list` lists the other scenes, `{program} demo --scene octopus` renders one"
    )
}

/// Submits the job over HTTP like any client, and waits for its picture.
async fn picture(client: &Client, text: Vec<u8>) -> anyhow::Result<Vec<u8>> {
    let id = client.submit(text, false).await?.id;
    follow::wait_for_success(client, id).await?;
    let mut picture = Vec::new();
    client.image(id, 0, &mut picture).await?;
    Ok(picture)
}

/// Saves the picture in the current folder under a free name; returns its full path.
fn save(picture: &[u8], scene: &str, job: &Job, force: bool) -> anyhow::Result<PathBuf> {
    let extension = match job.image.format {
        Format::Png => "png",
        Format::Exr => "exr",
    };
    let stem = scene.replace('/', "-");
    let plain = PathBuf::from(format!("{stem}.{extension}"));
    let path = if force { plain } else { free_name(plain, &stem, extension, picture)? };
    let name = path.display().to_string();
    let mut output = OutputFile::create(&name)?;
    std::io::Write::write_all(output.file(), picture).with_context(|| format!("could not write {name}"))?;
    output.commit()?;
    fs::canonicalize(&path).with_context(|| format!("could not find {name} again"))
}

/// Returns the plain name if it is free, otherwise one with a number.
fn free_name(plain: PathBuf, stem: &str, extension: &str, picture: &[u8]) -> anyhow::Result<PathBuf> {
    let numbered = (2..1000).map(|number| PathBuf::from(format!("{stem}-{number}.{extension}")));
    let is_free = |path: &Path| !path.exists() || fs::read(path).is_ok_and(|there| there == picture);
    std::iter::once(plain).chain(numbered).find(|path| is_free(path)).ok_or_else(|| {
        UsageError(format!("every name from {stem}.{extension} on exists here: use --force to replace the first"))
            .into()
    })
}
