//! A tree in which everything has been replaced, and its errors.

use std::collections::BTreeMap;

use crate::error::{Fault, LineIndex, ValidationError};
use crate::json::{Tree, Value};
use crate::parse::{MAX_ERRORS, depends};

/// A tree in which everything has been replaced.
#[derive(Debug)]
pub(in super::super) struct Expanded<'t> {
    /// The tree.
    pub tree: Tree<'t>,
    /// Names of shapes that stand for a shape with numbers, with the name of that shape.
    pub instances: BTreeMap<String, String>,
    /// Whether the tree is not complete, because it would be too large.
    pub is_too_large: bool,
    /// Errors in formulas: byte offsets in the user's text, and messages.
    pub(super) faults: Vec<(usize, String)>,
}

impl Expanded<'_> {
    /// Whether all formulas are sound.
    pub(in super::super) fn is_sound(&self) -> bool {
        self.faults.is_empty()
    }

    /// JSON pointers of the errors in formulas.
    pub(in super::super) fn wrong(&self, users: &Tree<'_>) -> Vec<String> {
        self.faults.iter().map(|(at, _)| users.pointer_at(*at)).collect()
    }

    /// Whether an error of meaning in the replaced tree is certain, although numbers stand for the formulas at the
    /// pointers `wrong`.
    pub(in super::super) fn is_sure(&self, users: &Tree<'_>, wrong: &[String], pointer: &str, at: usize) -> bool {
        if wrong.is_empty() {
            return true;
        }
        let (pointer, _) = self.users_place(users, pointer, Some(at));
        // The values beside this one may be wrong, but not a whole part of the job.
        let is_part = pointer.matches('/').count() < 3;
        let around = pointer.rsplit_once('/').filter(|_| !is_part).map_or(pointer.as_str(), |(around, _)| around);
        if has_wrong_name(wrong) && is_computed(users, around) {
            return false;
        }
        let has_use = |node: &str| users.value_at(node).is_none_or(|node| node.has_key("use"));
        depends::is_sure(&pointer, wrong, &has_use)
    }

    /// Moves errors in the replaced tree to their positions in the user's text, and adds those in formulas.
    pub(in super::super) fn place(&self, users: &Tree<'_>, errors: Vec<Fault>) -> Vec<ValidationError> {
        let lines = LineIndex::new(users.text());
        let place = |(at, message): &(usize, String)| lines.fault(*at, users.pointer_at(*at), message.clone());
        let mut all: Vec<ValidationError> = self.faults.iter().map(place).collect();
        // An error may be that of a number that stands for a wrong formula.
        let wrong: Vec<String> = all.iter().map(|fault| fault.pointer.clone()).collect();
        let stands = |pointer: &str| wrong.iter().any(|wrong| wrong.strip_suffix("/expr").unwrap_or(wrong) == pointer);
        let follows = |pointer: &str| has_wrong_name(&wrong) && is_computed(users, pointer);
        for Fault { pointer, message, at } in errors {
            let (pointer, at) = self.users_place(users, &pointer, at);
            if !stands(&pointer) && !follows(&pointer) {
                all.push(lines.fault(at, pointer, message));
            }
        }
        // An error in a shape is reported once for each use with other numbers.
        all.sort_by(|a, b| (a.line, a.column, &a.message).cmp(&(b.line, b.column, &b.message)));
        all.dedup();
        all.truncate(MAX_ERRORS);
        all
    }

    /// Pointer and byte offset in the user's text of what is at a pointer and an offset of the replaced tree.
    fn users_place(&self, users: &Tree<'_>, pointer: &str, at: Option<usize>) -> (String, usize) {
        let Some(at) = at else { return (pointer.to_owned(), 0) };
        let offset = self.tree.origin(at);
        let is_there = |found: Option<Value<'_>>| found.is_some_and(|found| found.start() == offset);
        let is_same = is_there(users.value_at(pointer)) || is_there(users.key_at(pointer));
        (if is_same { pointer.to_owned() } else { users.pointer_at(offset) }, offset)
    }
}

/// Whether a number with a name is wrong, at one of these pointers, so that formulas with its name have another value.
fn has_wrong_name(wrong: &[String]) -> bool {
    wrong.iter().any(|wrong| wrong.starts_with("/scene/numbers/") || wrong.contains("/use/with/"))
}

/// Whether a formula is in the value at a pointer.
fn is_computed(users: &Tree<'_>, pointer: &str) -> bool {
    users.value_at(pointer).is_some_and(|value| value.has_key("expr"))
}
