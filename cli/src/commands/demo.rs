//! `sdfarm demo`: starts a temporary farm, renders one picture on it, and leaves only the picture.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use proto::Client;
use scene::{Format, Job};
use server::{Config, Server};
use tokio_util::sync::CancellationToken;

use crate::commands::serve::own_program;
use crate::failure::Misuse;
use crate::output_file::OutputFile;
use crate::signals::Signals;
use crate::terminal::{note, say};
use crate::{follow, shipped};

const DEFAULT_SCENE: &str = "csg";

/// Arguments of `demo`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Which shipped scene to render.
    #[arg(long, value_name = "NAME", env = "SDFARM_SCENE", default_value = DEFAULT_SCENE)]
    scene: String,
    /// List the shipped scenes, and render none.
    #[arg(long, env = "SDFARM_LIST", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    list: bool,
    /// Replace a file of the picture's name in the current folder.
    #[arg(long, env = "SDFARM_FORCE", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    force: bool,
}

/// Lists the scenes, or renders one on a temporary farm.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    if arguments.list {
        return say(&shipped::names().join("\n"));
    }
    let text = shipped::job_file(&arguments.scene)?;
    let job = scene::parse(&text).with_context(|| format!("the shipped scene {} is damaged", arguments.scene))?;
    let mut signals = Signals::catch()?;

    let data = tempfile::tempdir().context("could not make a folder for the farm: free some space there")?;
    let config = Config {
        listen: ([127, 0, 0, 1], 0).into(),
        data: data.path().to_owned(),
        worker_program: own_program()?,
        ..Config::default()
    };
    let server = Server::start(config).await?;
    let client = Client::new(&format!("http://{}", server.address()))?;
    note(&format!("a farm serves {}; it renders {}", client.server(), arguments.scene));

    let shutdown = CancellationToken::new();
    let serving = tokio::spawn(server.run(shutdown.clone()));
    let done = tokio::select! {
        done = picture(&client, text) => done,
        () = signals.next() => Err(anyhow::anyhow!("interrupted: nothing was saved")),
    };
    shutdown.cancel();
    serving.await.context("the farm stopped in disorder")??;
    say(&save(&done?, &arguments.scene, &job, arguments.force)?)
}

/// Submits the job over HTTP like any client, and waits for its picture.
async fn picture(client: &Client, text: Vec<u8>) -> anyhow::Result<Vec<u8>> {
    let id = client.submit(text, false).await?.id;
    follow::until_done(client, id).await?;
    let mut picture = Vec::new();
    client.image(id, 0, &mut picture).await?;
    Ok(picture)
}

/// Saves the picture in the current folder under a free name; returns the message to print.
fn save(picture: &[u8], scene: &str, job: &Job, force: bool) -> anyhow::Result<String> {
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
    Ok(format!("saved {name} ({}×{})", job.image.width, job.image.height))
}

/// The plain name if it is free, else one with a number.
fn free_name(plain: PathBuf, stem: &str, extension: &str, picture: &[u8]) -> anyhow::Result<PathBuf> {
    let numbered = (2..1000).map(|number| PathBuf::from(format!("{stem}-{number}.{extension}")));
    let is_free = |path: &Path| !path.exists() || fs::read(path).is_ok_and(|there| there == picture);
    std::iter::once(plain).chain(numbered).find(|path| is_free(path)).ok_or_else(|| {
        Misuse(format!("every name from {stem}.{extension} on is taken here: say --force to replace the first")).into()
    })
}
