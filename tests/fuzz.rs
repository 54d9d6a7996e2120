//! Fuzzing on a stable toolchain: sound inputs, spoilt by chance, go through every reader of what comes from outside,
//! and through the writers and back. Nothing may panic, hang, or read back as something else.
//!
//! `SDFARM_FUZZ_SECONDS` is how long each target runs (2 unless said), or `SDFARM_FUZZ_RUNS` how often;
//! `SDFARM_FUZZ_SEED` chooses what is tried. A finding prints its input in hex, for `regressions`.

mod chance;
mod messages;
mod pictures;
mod requests;
mod stored;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use chance::Chance;

const USUAL_SECONDS: u64 = 2;
/// No input is larger.
const MOST_BYTES: usize = 64 << 10;
/// No single input takes longer, on a slow machine.
const PATIENCE: Duration = Duration::from_secs(10);

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

/// Tries a target with inputs made of a corpus until the time is over, or the runs are done.
fn fuzz(target: &str, corpus: &[Vec<u8>], mut run: impl FnMut(&[u8])) {
    let seed = number("SDFARM_FUZZ_SEED").unwrap_or(1);
    let most = number("SDFARM_FUZZ_RUNS");
    let time = Duration::from_secs(number("SDFARM_FUZZ_SECONDS").unwrap_or(USUAL_SECONDS));
    let mut chance = Chance::new(seed);
    let start = Instant::now();
    let mut runs = 0;
    let mut slowest = Duration::ZERO;
    let mut attempt = |input: &[u8]| {
        let begun = Instant::now();
        let done = catch_unwind(AssertUnwindSafe(|| run(input)));
        let took = begun.elapsed();
        assert!(done.is_ok(), "{target}: a finding of seed {seed}: {}", hex(input));
        assert!(took < PATIENCE, "{target}: {took:?} for an input of seed {seed}: {}", hex(input));
        slowest = slowest.max(took);
    };
    for input in corpus {
        attempt(input);
    }
    while most.map_or_else(|| start.elapsed() < time, |most| runs < most) {
        attempt(&chance.spoil(corpus, MOST_BYTES));
        runs += 1;
    }
    eprintln!("fuzzed {target}: {runs} runs in {:.1?}, the slowest took {slowest:.1?}", start.elapsed());
    assert!(runs > 0, "{target}: no run at all");
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"))
}
