//! Writes pictures to files: complete or not at all.
//!
//! Bytes go to a temporary file next to the target, which takes the target's name only when it is complete
//! and on disk. A pipe or a device gets a copy of the complete file.

use std::fs::{self, File, Permissions};
use std::io::{self, Read};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::Context;
use scene::{Format, Job};
use tempfile::NamedTempFile;

use crate::error::UsageError;
use crate::terminal::write_bytes;

/// Mode of a new file, before the process's umask.
const MODE: u32 = 0o666;
const COPIED_BYTES: usize = 1 << 20;

#[derive(Debug)]
enum Target {
    Standard,
    /// An existing target that cannot be replaced: a pipe or a device.
    Special(PathBuf),
    Regular(PathBuf),
}

/// Output file being written.
#[derive(Debug)]
pub(crate) struct OutputFile {
    name: String,
    temporary: NamedTempFile,
    target: Target,
}

impl OutputFile {
    /// Prepares to write `path`, or standard output for `-`.
    pub(crate) fn create(path: &str) -> anyhow::Result<Self> {
        let target = classify_target(path)?;
        let folder = match &target {
            Target::Standard | Target::Special(_) => std::env::temp_dir(),
            Target::Regular(path) => folder_of(path).to_owned(),
        };
        if !folder.is_dir() {
            return Err(UsageError(format!("there is no folder {}: create it first", folder.display())).into());
        }
        let temporary = tempfile::Builder::new()
            .prefix(".sdfarm-")
            .suffix(".part")
            .permissions(Permissions::from_mode(MODE))
            .tempfile_in(&folder)
            .map_err(|error| {
                // The error names the temporary file, which means nothing to a user, so only its kind is printed.
                UsageError(format!(
                    "could not write to the folder {}: {}; write elsewhere",
                    folder.display(),
                    error.kind()
                ))
            })?;
        Ok(Self { name: path.to_owned(), temporary, target })
    }

    /// File to write to.
    pub(crate) fn file(&mut self) -> &mut File {
        self.temporary.as_file_mut()
    }

    /// Path of the temporary file, for a signal handler that must delete it.
    pub(crate) fn temporary_path(&self) -> &Path {
        self.temporary.path()
    }

    /// Folder of the file.
    pub(crate) fn folder(&self) -> &Path {
        folder_of(self.temporary.path())
    }

    /// Publishes the file under its name, once all of its bytes are on disk.
    pub(crate) fn commit(self) -> anyhow::Result<()> {
        let Self { name, temporary, target } = self;
        let context = || format!("could not write {name}: free some space there, or write elsewhere");
        match target {
            Target::Standard => copy(&temporary, &mut |bytes| write_bytes(bytes)),
            Target::Special(path) => {
                let mut file = File::options().write(true).open(path).with_context(context)?;
                copy(&temporary, &mut |bytes| io::Write::write_all(&mut file, bytes).with_context(context))
            }
            Target::Regular(path) => {
                temporary.as_file().sync_all().with_context(context)?;
                temporary.persist(&path).map_err(|error| error.error).with_context(context)?;
                File::open(folder_of(&path)).and_then(|folder| folder.sync_all()).with_context(context)
            }
        }
    }
}

/// Whether a path names a folder: an existing one, or one to create, whose path ends in a slash.
pub(crate) fn is_folder(path: &str) -> bool {
    path != "-" && (path.ends_with('/') || Path::new(path).is_dir())
}

/// Makes sure that a picture can be written to `path` later: creates a folder, or tries to write to a file's folder.
pub(crate) fn check_writable(path: &str) -> anyhow::Result<()> {
    if !is_folder(path) {
        return OutputFile::create(path).map(drop);
    }
    make_folder(path)?;
    tempfile::tempfile_in(path).map(drop).map_err(|error| {
        UsageError(format!("could not write to the folder {path}: {}; write elsewhere", error.kind())).into()
    })
}

/// Creates a folder for pictures if it is missing.
pub(crate) fn make_folder(path: &str) -> anyhow::Result<()> {
    fs::create_dir_all(path)
        .map_err(|error| UsageError(format!("could not create the folder {path}: {error}; write elsewhere")).into())
}

/// The picture format a file's extension names; `None` for `-`, which has none.
pub(crate) fn format_of(path: &str) -> anyhow::Result<Option<Format>> {
    if path == "-" {
        return Ok(None);
    }
    let extension = Path::new(path).extension().map(|extension| extension.to_string_lossy().to_lowercase());
    match extension.as_deref() {
        Some("png") => Ok(Some(Format::Png)),
        Some("exr") => Ok(Some(Format::Exr)),
        Some(_) | None => Err(UsageError(format!("{path:?} has no picture format: end it in .png or .exr")).into()),
    }
}

/// Rejects a picture whose format cannot store what the job asks for.
pub(crate) fn check_format(job: &Job) -> anyhow::Result<()> {
    if job.image.format == Format::Exr && job.image.has_display_transform() {
        let fix = "an EXR is linear: write to a .png file, or remove image.exposure and image.tone_map from the job";
        return Err(UsageError(fix.to_owned()).into());
    }
    Ok(())
}

fn classify_target(path: &str) -> anyhow::Result<Target> {
    if path == "-" {
        return Ok(Target::Standard);
    }
    let wrong = |reason: String| anyhow::Error::new(UsageError(format!("could not write {path}: {reason}")));
    match fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Target::Regular(PathBuf::from(path))),
        Err(error) => Err(wrong(error.to_string())),
        Ok(there) if there.is_dir() => Err(wrong("it is a folder; give a file in it".to_owned())),
        // A symbolic link is followed to its target.
        Ok(there) if there.is_file() => {
            Ok(Target::Regular(fs::canonicalize(path).map_err(|error| wrong(error.to_string()))?))
        }
        Ok(_) => Ok(Target::Special(PathBuf::from(path))),
    }
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        Some(_) | None => Path::new("."),
    }
}

fn copy(from: &NamedTempFile, to: &mut dyn FnMut(&[u8]) -> anyhow::Result<()>) -> anyhow::Result<()> {
    let mut whole = from.reopen().context("could not read back the picture")?;
    let mut buffer = vec![0; COPIED_BYTES];
    loop {
        match whole.read(&mut buffer).context("could not read back the picture")? {
            0 => return Ok(()),
            length => to(&buffer[..length])?,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn file_appears_complete_and_an_abandoned_one_leaves_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.png");
        let name = path.to_str().expect("a plain name");

        let mut abandoned = OutputFile::create(name).expect("created");
        abandoned.file().write_all(b"half").expect("written");
        drop(abandoned);
        assert_eq!(fs::read_dir(folder.path()).expect("read").count(), 0);

        let mut whole = OutputFile::create(name).expect("created");
        whole.file().write_all(b"whole").expect("written");
        assert!(!path.exists());
        whole.commit().expect("committed");
        assert_eq!(fs::read(&path).expect("read"), b"whole");
        assert_eq!(fs::read_dir(folder.path()).expect("read").count(), 1);
    }

    #[test]
    fn extension_names_the_format() {
        assert_eq!(format_of("a/b.PNG").expect("known"), Some(Format::Png));
        assert_eq!(format_of("b.exr").expect("known"), Some(Format::Exr));
        assert_eq!(format_of("-").expect("standard output"), None);
        for bad in ["b", "b.jpg", ".png/b"] {
            assert!(format_of(bad).expect_err(bad).is::<UsageError>());
        }
    }

    #[test]
    fn device_is_written_but_not_replaced() {
        let mut file = OutputFile::create("/dev/null").expect("created");
        file.file().write_all(b"gone").expect("written");
        file.commit().expect("committed");
        assert!(!fs::metadata("/dev/null").expect("there").is_file());
    }
}
