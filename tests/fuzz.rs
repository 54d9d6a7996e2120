//! Fuzzing on a stable toolchain: randomly mutated valid inputs go through every parser of external data, and through
//! the writers and back. Nothing may panic, hang, or read back as a different value.
//! Each target runs a few hundred times in every test run, and for 60 s in long ones. `SDFARM_FUZZ_SECONDS` or
//! `SDFARM_FUZZ_RUNS` sets the time or the number of runs for each target, and `SDFARM_FUZZ_SEED` the inputs. A finding
//! prints its input in hex, for `regressions`.

mod messages;
mod mutate;
mod pictures;
mod requests;
mod stored;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use mutate::SeededRng;

/// Maximum size of an input.
const MOST_BYTES: usize = 64 << 10;

/// Default effort for a target.
#[derive(Clone, Copy, Debug)]
enum Effort {
    /// This number of inputs, the same in every run.
    Runs(u64),
    /// 60 s.
    Long,
}

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

/// Runs a target with inputs mutated from a corpus, for the given time or number of runs.
fn fuzz(target: &str, effort: Effort, corpus: &[Vec<u8>], mut run: impl FnMut(&[u8])) {
    let seed = number("SDFARM_FUZZ_SEED").unwrap_or(1);
    let (runs, time) = match (number("SDFARM_FUZZ_RUNS"), number("SDFARM_FUZZ_SECONDS"), effort) {
        (Some(runs), _, _) | (None, None, Effort::Runs(runs)) => (Some(runs), Duration::MAX),
        (None, Some(seconds), _) => (None, Duration::from_secs(seconds)),
        (None, None, Effort::Long) => (None, Duration::from_mins(1)),
    };
    let mut random = SeededRng::new(seed);
    let start = Instant::now();
    let mut done = 0;
    let mut slowest = Duration::ZERO;
    let mut attempt = |input: &[u8]| {
        let begun = Instant::now();
        let sound = catch_unwind(AssertUnwindSafe(|| run(input)));
        assert!(sound.is_ok(), "{target}: a finding of seed {seed}: {}", hex(input));
        slowest = slowest.max(begun.elapsed());
    };
    for input in corpus {
        attempt(input);
    }
    while runs.map_or_else(|| start.elapsed() < time, |runs| done < runs) {
        attempt(&random.spoil(corpus, MOST_BYTES));
        done += 1;
    }
    eprintln!("fuzzed {target}: {done} runs in {:.1?}, the slowest took {slowest:.1?}", start.elapsed());
    assert!(done > 0, "{target}: no run at all");
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"))
}
