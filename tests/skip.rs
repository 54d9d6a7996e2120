//! The one way to skip a test: it says aloud what this machine lacks, and fails where nothing may be skipped.
//!
//! `SDFARM_MAY_SKIP` names, with commas between them, what tests may do without; if it is set, a test that lacks
//! anything else fails. `.ci/run` sets it. Every test binary includes this file.

use std::fmt::Display;

const VARIABLE: &str = "SDFARM_MAY_SKIP";

/// Skips the rest of a test that needs `need`, a short name. `lacking` says what is not tested, and why.
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
fn only_what_is_named_may_be_skipped_where_names_are_given() {
    assert!(may_skip("unzip", None));
    assert!(may_skip("unzip", Some("netem, unzip")));
    assert!(!may_skip("unzip", Some("netem")));
    assert!(!may_skip("unzip", Some("")));
}
