//! A text in which everything has been replaced, and its errors.

use std::collections::BTreeMap;

use super::scan::{self, end_of};
use super::source::Source;
use crate::error::ValidationError;
use crate::json_scan::locate_value;
use crate::parse::{MAX_ERRORS, depends};

/// A text in which everything has been replaced.
#[derive(Debug)]
pub(in super::super) struct Expanded {
    /// The text.
    pub text: String,
    /// Names of shapes that stand for a shape with numbers, with the name of that shape.
    pub instances: BTreeMap<String, String>,
    pub(super) source: Source,
    /// Errors in formulas: byte offsets in the user's text, and messages.
    pub(super) faults: Vec<(usize, String)>,
}

impl Expanded {
    /// Whether all formulas are sound.
    pub(in super::super) fn is_sound(&self) -> bool {
        self.faults.is_empty()
    }

    /// JSON pointers of the errors in formulas.
    pub(in super::super) fn wrong(&self, users: &str) -> Vec<String> {
        scan::faults_at(users, &self.faults).into_iter().map(|fault| fault.pointer).collect()
    }

    /// Whether an error of meaning in the replaced text is certain, although numbers stand for the formulas at the
    /// pointers `wrong`.
    pub(in super::super) fn is_sure(&self, users: &str, wrong: &[String], pointer: &str, at: usize) -> bool {
        if wrong.is_empty() {
            return true;
        }
        let (pointer, _) = self.source.pointer(&self.text, users, pointer, at);
        // The values beside this one may be what is wrong, but not those of a whole part of the job.
        let is_part = pointer.matches('/').count() < 3;
        let around = pointer.rsplit_once('/').filter(|_| !is_part).map_or(pointer.as_str(), |(around, _)| around);
        if has_wrong_name(wrong) && is_computed(users, around) {
            return false;
        }
        let has_use = |node: &str| {
            let node = locate_value(users, node);
            node.is_none_or(|start| users[start..end_of(users, start)].contains("\"use\""))
        };
        depends::is_sure(&pointer, wrong, &has_use)
    }

    /// Moves errors in the replaced text to their positions in the user's, and adds those in formulas.
    pub(in super::super) fn place(&self, users: &str, errors: Vec<ValidationError>) -> Vec<ValidationError> {
        let moved = self.source.place(&self.text, users, errors);
        let mut all = scan::faults_at(users, &self.faults);
        // An error may be that of a number that stands for a wrong formula.
        let wrong: Vec<String> = all.iter().map(|fault| fault.pointer.clone()).collect();
        let stands = |pointer: &str| wrong.iter().any(|wrong| wrong.strip_suffix("/expr").unwrap_or(wrong) == pointer);
        let follows = |pointer: &str| has_wrong_name(&wrong) && is_computed(users, pointer);
        let is_certain = |error: &ValidationError| !stands(&error.pointer) && !follows(&error.pointer);
        all.extend(moved.into_iter().filter(is_certain));
        // An error in a shape is reported once for each use with other numbers.
        all.sort_by(|a, b| (a.line, a.column, &a.message).cmp(&(b.line, b.column, &b.message)));
        all.dedup();
        all.truncate(MAX_ERRORS);
        all
    }
}

/// Whether a number with a name is wrong, at one of these pointers, so that formulas with its name have another value.
fn has_wrong_name(wrong: &[String]) -> bool {
    wrong.iter().any(|wrong| wrong.starts_with("/scene/numbers/") || wrong.contains("/use/with/"))
}

/// Whether a formula is in the value at a pointer.
fn is_computed(users: &str, pointer: &str) -> bool {
    locate_value(users, pointer).is_some_and(|start| users[start..end_of(users, start)].contains("\"expr\""))
}
