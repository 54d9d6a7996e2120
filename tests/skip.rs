//! The only way to skip a test: it prints what this machine lacks, and fails if the test must not be skipped.
//! `SDFARM_MAY_SKIP` lists, separated by commas, what may be missing; if it is set, a test that lacks anything else
//! fails. `.ci/run` sets it. Every test binary includes this file.

use std::fmt::Display;

const VARIABLE: &str = "SDFARM_MAY_SKIP";

/// Skips the rest of a test that needs `need`, a short name. `lacking` is the part that is not tested, and the reason.
pub(crate) fn skip(need: &str, lacking: impl Display) {
    let allowed = std::env::var(VARIABLE).ok();
    assert!(
        may_skip(need, allowed.as_deref()),
        "this test needs {need} and may not be skipped here: {lacking}; install it, or name it in {VARIABLE}"
    );
    println!("skipped: {lacking} [{need}]");
}

fn may_skip(need: &str, allowed: Option<&str>) -> bool {
    allowed.is_none_or(|names| names.split(',').any(|name| name.trim() == need))
}

#[test]
fn only_listed_needs_may_be_skipped() {
    assert!(may_skip("unzip", None));
    assert!(may_skip("unzip", Some("netem, unzip")));
    assert!(!may_skip("unzip", Some("netem")));
    assert!(!may_skip("unzip", Some("")));
}
