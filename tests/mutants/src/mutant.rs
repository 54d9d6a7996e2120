//! Selects the mutant of this process; `mutants instrument` copies this file into each crate that it changes.

use std::io::Write;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

const MAX_MUTANTS: usize = 10_000;

/// Whether this process runs mutant `n`. With `SDFARM_MUTANT_REACHED`, the number is also appended to that file, once.
pub(crate) fn is(n: u32) -> bool {
    static CHOSEN: OnceLock<u32> = OnceLock::new();
    static LOG: OnceLock<Option<std::fs::File>> = OnceLock::new();
    static REACHED: [AtomicBool; MAX_MUTANTS] = [const { AtomicBool::new(false) }; MAX_MUTANTS];
    let log = LOG.get_or_init(|| {
        let path = std::env::var_os("SDFARM_MUTANT_REACHED")?;
        Some(std::fs::OpenOptions::new().create(true).append(true).open(path).expect("the file can be written"))
    });
    if let Some(mut log) = log.as_ref()
        && !REACHED[n as usize].swap(true, Relaxed)
    {
        log.write_all(format!("{n}\n").as_bytes()).expect("the disk has space");
    }
    n == *CHOSEN.get_or_init(|| std::env::var("SDFARM_MUTANT").ok().and_then(|n| n.parse().ok()).unwrap_or(0))
}

/// The SQL of the selected mutant, or the original.
#[allow(dead_code)]
pub(crate) fn pick(original: &'static str, mutants: &[(u32, &'static str)]) -> &'static str {
    // Without a short cut, because every one of them is reached.
    mutants.iter().fold(original, |chosen, (n, sql)| if is(*n) { sql } else { chosen })
}
