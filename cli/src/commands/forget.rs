//! `sdfarm forget`: has a server forget a picture everywhere, and render the frames that showed it again.

use std::str::FromStr;

use clap::Args;
use proto::Client;

use crate::arguments::ServerArguments;
use crate::counted::counted;
use crate::error::UsageError;
use crate::job_name::JobName;
use crate::terminal::print_note;

/// Arguments of `forget`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The picture: the BLAKE3 of its bytes, or the frame that shows it, as JOB/FRAME.
    #[arg(value_name = "HASH|JOB/FRAME")]
    picture: PictureName,
    #[command(flatten)]
    server: ServerArguments,
}

/// A user's name for a picture.
#[derive(Clone, Debug)]
enum PictureName {
    Hash(String),
    Frame(JobName, u32),
}

impl FromStr for PictureName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Ok(Self::Hash(text.to_ascii_lowercase()));
        }
        let wrong = || "give the 64 hexadecimal digits of its hash, or JOB/FRAME such as latest/0".to_owned();
        let (job, frame) = text.rsplit_once('/').ok_or_else(wrong)?;
        let Ok(job) = job.parse();
        Ok(Self::Frame(job, frame.parse().map_err(|_| wrong())?))
    }
}

impl PictureName {
    async fn find(self, client: &Client) -> anyhow::Result<String> {
        let (job, frame) = match self {
            Self::Hash(hash) => return Ok(hash),
            Self::Frame(job, frame) => (job.find(client).await?, frame),
        };
        let cursor = frame.to_string();
        let page = client.frames(job, Some(&cursor)).await?;
        let found = page.frames.into_iter().next().filter(|found| found.number == frame);
        let picture = found.and_then(|found| found.picture);
        Ok(picture.ok_or_else(|| UsageError(format!("frame {frame} of job {job} has no stored picture")))?)
    }
}

/// Has the server forget the picture.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let hash = arguments.picture.find(&client).await?;
    let forgotten = client.forget_picture(&hash).await?;
    print_note(&format!(
        "forgot {hash}: {} rendered again, {} of failed or cancelled jobs without a picture now",
        counted(forgotten.frames_rendered_again, "frame"),
        counted(forgotten.frames_without_picture, "frame")
    ));
    Ok(())
}
