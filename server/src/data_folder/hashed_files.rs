//! Files named by the BLAKE3 of their bytes: verified, linked and copied, each one completely or not at all.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::Path;

use crate::private_files;

/// Number of bytes read and written at a time.
const PIECE_BYTES: usize = 1 << 20;

/// BLAKE3 of a file's bytes, in hex, and its size.
pub(super) fn hash(path: &Path) -> io::Result<(String, u64)> {
    copy_bytes(&mut File::open(path)?, &mut io::sink())
}

fn copy_bytes(from: &mut dyn Read, to: &mut dyn Write) -> io::Result<(String, u64)> {
    let mut hasher = blake3::Hasher::new();
    let mut piece = vec![0; PIECE_BYTES];
    loop {
        let read = from.read(&mut piece)?;
        if read == 0 {
            return Ok((hasher.finalize().to_hex().to_string(), hasher.count()));
        }
        hasher.update(&piece[..read]);
        to.write_all(&piece[..read])?;
    }
}

/// Copies a file if its bytes match `name`; otherwise returns false and leaves no file.
pub(super) fn copy(from: &Path, to: &Path, name: &str) -> io::Result<bool> {
    let part = to.with_extension("part");
    let mut source = File::open(from)?;
    let mut target = private_files::create_file(&part)?;
    let copied = copy_bytes(&mut source, &mut target).and_then(|copied| target.sync_all().map(|()| copied));
    match copied {
        Ok((actual, _)) if actual == name => {
            fs::set_permissions(&part, source.metadata()?.permissions())?;
            fs::rename(&part, to)?;
            Ok(true)
        }
        Ok(_) => {
            fs::remove_file(&part)?;
            Ok(false)
        }
        Err(error) => {
            // The disk may be full, so the partial file must not take space.
            let _ = fs::remove_file(&part);
            Err(error)
        }
    }
}

/// Links a file, or copies it if it cannot be linked, provided that its bytes match `name`.
pub(super) fn link(from: &Path, to: &Path, name: &str) -> io::Result<bool> {
    if hash(from)?.0 != name {
        return Ok(false);
    }
    match fs::hard_link(from, to) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(error),
        Err(_) => copy(from, to, name),
    }
}

/// Fsyncs a folder, so that the names in it survive a power cut.
pub(super) fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}
