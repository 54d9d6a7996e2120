//! Finds the bytes of a picture, and the jobs that it may be of.

use std::io::Read;

use proto::{Client, ClientError, JobId};
use scene::Job;
use worker::image::stored::{FoundProvenance, StoredPicture, UnreadablePicture};

use super::{Arguments, is_file};
use crate::commands::render::check_frame;
use crate::error::UsageError;
use crate::job_file::JobFile;
use crate::job_name::JobName;

/// Maximum number of jobs of one scene that are tried.
const MAX_CANDIDATES: u32 = 50;

/// A picture to verify.
pub(super) struct VerifiedPicture {
    /// Its name, for people.
    pub(super) name: String,
    /// Bytes of its file.
    pub(super) file: Vec<u8>,
    /// Frame of the jobs.
    pub(super) frame: u32,
    /// The jobs that it may be of, one or more.
    pub(super) jobs: Vec<Candidate>,
    /// The server that has the jobs.
    pub(super) client: Option<Client>,
}

/// A job that a picture may be of.
pub(super) struct Candidate {
    /// The job.
    pub(super) job: Job,
    /// Name of the job, for people.
    pub(super) origin: String,
    /// Its id on the farm.
    pub(super) id: Option<JobId>,
}

/// Finds what the arguments name.
pub(super) async fn source(arguments: &Arguments) -> anyhow::Result<VerifiedPicture> {
    if is_file(&arguments.picture) {
        return of_file(arguments).await;
    }
    if arguments.picture.contains('/') || [".png", ".exr"].iter().any(|end| arguments.picture.ends_with(end)) {
        return Err(UsageError(format!(
            "there is no file {}: give an existing picture, or a job of the farm",
            arguments.picture
        ))
        .into());
    }
    let client = arguments.server.client()?;
    let name: JobName = arguments.picture.parse()?;
    let id = name.find(&client).await?;
    let frame = arguments.frame.unwrap_or(0);
    let mut file = Vec::new();
    client.image(id, frame, &mut file).await?;
    let candidate = match &arguments.job {
        Some(path) => Candidate { id: Some(id), ..local(arguments, path, None)? },
        None => remote(&client, id).await?,
    };
    check_frame(&candidate.job, frame)?;
    let name = format!("frame {frame} of job {id}");
    Ok(VerifiedPicture { name, file, frame, jobs: vec![candidate], client: Some(client) })
}

async fn of_file(arguments: &Arguments) -> anyhow::Result<VerifiedPicture> {
    let name = if arguments.picture == "-" { "standard input" } else { &arguments.picture }.to_owned();
    let mut file = Vec::new();
    let read = if arguments.picture == "-" {
        std::io::stdin().lock().read_to_end(&mut file).map(drop)
    } else {
        std::fs::read(&arguments.picture).map(|bytes| file = bytes)
    };
    read.map_err(|error| UsageError(format!("could not read {name}: {error}; give an existing picture")))?;
    let stored = StoredPicture::read(&file);
    if let Err(UnreadablePicture::NotAPicture) = stored {
        return Err(
            UsageError(format!("{name} is neither a PNG nor an EXR: give a picture, or a job of the farm")).into()
        );
    }
    let provenance = match &stored {
        Ok(StoredPicture { provenance: FoundProvenance::Known(known), .. }) => Some(known),
        Ok(_) | Err(_) => None,
    };
    let frame = arguments.frame.or(provenance.map(|known| known.frame)).unwrap_or(0);
    if let Some(path) = &arguments.job {
        let candidate = local(arguments, path, stored.as_ref().ok())?;
        check_frame(&candidate.job, frame)?;
        return Ok(VerifiedPicture { name, file, frame, jobs: vec![candidate], client: None });
    }
    let client = arguments.server.client()?;
    let hash = blake3::hash(&file).to_hex().to_string();
    let mut found = client.jobs_of_picture("picture", &hash, MAX_CANDIDATES).await.map_err(without_server)?;
    if let (Some(known), true) = (provenance, found.jobs.is_empty()) {
        found = client.jobs_of_picture("scene", &known.scene, MAX_CANDIDATES).await?;
    }
    let mut jobs: Vec<Candidate> = Vec::new();
    for view in found.jobs {
        let candidate = remote(&client, view.id).await?;
        let key = |candidate: &Candidate| candidate.job.cache_key(frame);
        // A job that was submitted again makes the same picture.
        if frame < candidate.job.frames.count && !jobs.iter().any(|known| key(known) == key(&candidate)) {
            jobs.push(candidate);
        }
    }
    if jobs.is_empty() {
        return Err(unknown(&name, provenance.map(|known| known.scene.as_str()), client.server()).into());
    }
    Ok(VerifiedPicture { name, file, frame, jobs, client: Some(client) })
}

/// Error for a picture whose job the farm does not have.
fn unknown(name: &str, scene: Option<&str>, server: &str) -> UsageError {
    UsageError(match scene {
        Some(scene) => format!(
            "{name} says that it was made from the scene {}, of which the farm at {server} has no job: give the job \
             file with --job, or another farm with --server",
            scene.escape_debug()
        ),
        None => format!(
            "{name} does not say what it was made from, and the farm at {server} has no picture with these bytes: give \
             the job file with --job"
        ),
    })
}

fn without_server(error: ClientError) -> anyhow::Error {
    match error {
        unreachable @ ClientError::Unreachable { .. } => UsageError(format!(
            "could not look for the picture's job: {unreachable}; give the job file with --job, or a farm with --server"
        ))
        .into(),
        other => other.into(),
    }
}

/// The job in a file; it makes the format that the picture has, as `sdfarm render -o` lets it.
fn local(arguments: &Arguments, path: &str, stored: Option<&StoredPicture>) -> anyhow::Result<Candidate> {
    let mut job = arguments.overrides.apply(JobFile::read(path)?)?.parse()?;
    if let Some(stored) = stored {
        job.image.format = stored.format;
    }
    Ok(Candidate { job, origin: path.to_owned(), id: None })
}

async fn remote(client: &Client, id: JobId) -> anyhow::Result<Candidate> {
    let mut text = Vec::new();
    client.file(id, &mut text).await?;
    let job = JobFile { name: format!("job {id}"), text }.parse()?;
    Ok(Candidate { job, origin: format!("job {id} at {}", client.server()), id: Some(id) })
}
