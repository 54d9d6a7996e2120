//! The numbers that names in formulas stand for: those of the scene and of a shape, and counted copies.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use super::scan::{self, members};
use super::stand_in;
use crate::values::formula::{self, Expr, FUNCTIONS, NAMES, Names, is_name};
use crate::values::track::Track;

/// Maximum number of numbers between a number and one that it is computed from.
const MAX_CHAIN: usize = 32;
/// Maximum number of named numbers.
const MAX_NUMBERS: usize = 10_000;

/// The numbers of a scene, by name.
#[derive(Debug)]
pub(super) struct Numbers<'t> {
    text: &'t str,
    defined: BTreeMap<String, Definition>,
    /// Keys of the numbers, in their order.
    keys: Vec<Range<usize>>,
    /// Number of frames of the job.
    frames: Option<Arc<Expr>>,
    /// Numbers that are being computed.
    open: Vec<String>,
}

#[derive(Clone, Debug)]
enum Definition {
    /// As written, at this byte range.
    Written(Range<usize>),
    /// Being computed.
    Open,
    Known(Arc<Expr>),
}

/// Names that a part of the job knows in addition to the scene's.
#[derive(Debug)]
pub(super) struct Scope<'s> {
    /// Numbers of the shape.
    with: &'s BTreeMap<String, Arc<Expr>>,
    /// Number of the copy, and of all copies.
    counter: Option<(u32, u32)>,
    /// Whether this is inside a named shape.
    pub(super) is_in_shape: bool,
    /// Whether this is copied by copies that are counted.
    pub(super) is_copied: bool,
    /// All names that were asked for.
    pub(super) asked: BTreeSet<String>,
}

impl<'s> Scope<'s> {
    pub(super) fn new(with: &'s BTreeMap<String, Arc<Expr>>) -> Self {
        Self { with, counter: None, is_in_shape: false, is_copied: false, asked: BTreeSet::new() }
    }

    /// Number of the copy, if copies are counted.
    pub(super) fn copy(&self) -> Option<u32> {
        self.counter.map(|(index, _)| index)
    }

    /// Runs `walk` for one of `count` copies.
    pub(super) fn counting<T>(&mut self, index: u32, count: u32, walk: impl FnOnce(&mut Self) -> T) -> T {
        let before = self.counter.replace((index, count));
        let result = walk(self);
        self.counter = before;
        result
    }

    pub(super) fn names<'a, 't>(
        &'a mut self,
        numbers: &'a mut Numbers<'t>,
        faults: &'a mut BTreeSet<(usize, String)>,
    ) -> impl Names + use<'a, 't, 's> {
        InScope { scope: self, numbers, faults }
    }
}

struct InScope<'a, 's, 't> {
    scope: &'a mut Scope<'s>,
    numbers: &'a mut Numbers<'t>,
    faults: &'a mut BTreeSet<(usize, String)>,
}

impl Names for InScope<'_, '_, '_> {
    fn get(&mut self, name: &str) -> Option<Arc<Expr>> {
        if !self.scope.asked.contains(name) {
            self.scope.asked.insert(name.to_owned());
        }
        let number = |number: u32| Some(Arc::new(Expr::Number(number as f32)));
        match (name, self.scope.counter) {
            ("i", Some((index, _))) => return number(index),
            ("n", Some((_, count))) => return number(count),
            _ => {}
        }
        self.scope.with.get(name).cloned().or_else(|| self.numbers.get(name, self.faults))
    }

    fn place(&self) -> &'static str {
        if self.scope.is_in_shape {
            "the scene's numbers, or to \"with\" in each use of this shape"
        } else {
            "the scene's numbers"
        }
    }

    fn is_copied(&self) -> bool {
        self.scope.is_copied
    }

    fn all(&self) -> Vec<String> {
        self.scope.with.keys().chain(self.numbers.defined.keys()).cloned().collect()
    }
}

/// The scene's numbers alone.
struct InScene<'a, 't>(&'a mut Numbers<'t>, &'a mut BTreeSet<(usize, String)>);

impl Names for InScene<'_, '_> {
    fn get(&mut self, name: &str) -> Option<Arc<Expr>> {
        self.0.get(name, self.1)
    }

    fn all(&self) -> Vec<String> {
        self.0.defined.keys().cloned().collect()
    }
}

impl<'t> Numbers<'t> {
    pub(super) fn new(text: &'t str, root: usize, scene: Option<usize>) -> Self {
        let numbers = scene.and_then(|scene| scan::member(text, scene, "numbers"));
        let numbers: Vec<_> = numbers.into_iter().flat_map(|numbers| members(text, numbers)).collect();
        let keys = numbers.iter().map(|(key, _)| key.clone()).collect();
        let defined = numbers.into_iter().map(|(key, value)| (scan::string(text, &key), Definition::Written(value)));
        let frames = scan::member(text, root, "frames");
        let count = match frames.map(|frames| scan::member(text, frames, "count")) {
            None | Some(None) => Some(1.0),
            Some(Some(count)) => text[count..scan::end_of(text, count)].parse().ok(),
        };
        let frames = count.map(|count| Arc::new(Expr::Number(count)));
        Self { text, defined: defined.collect(), keys, frames, open: Vec::new() }
    }

    /// Computes all numbers, so that every error in them is found.
    pub(super) fn resolve_all(&mut self, faults: &mut BTreeSet<(usize, String)>) {
        if self.keys.len() > MAX_NUMBERS {
            let message = format!("is one of {} numbers: use at most {MAX_NUMBERS}", self.keys.len());
            faults.insert((self.keys[MAX_NUMBERS].start, message));
            self.keys.truncate(MAX_NUMBERS);
        }
        for key in self.keys.clone() {
            let name = scan::string(self.text, &key);
            if !is_name(&name) {
                let message = "cannot be named in formulas: use letters, digits and _, the first not a digit";
                faults.insert((key.start, message.to_owned()));
            } else if let Some((_, about)) = NAMES.iter().find(|(known, _)| *known == name) {
                faults.insert((key.start, format!("stands for {}, in every formula: use another name", the(about))));
            } else if FUNCTIONS.iter().any(|function| function.name == name) {
                faults.insert((key.start, "is the name of a function: use another".to_owned()));
            }
            self.get(&name, faults);
        }
    }

    fn get(&mut self, name: &str, faults: &mut BTreeSet<(usize, String)>) -> Option<Arc<Expr>> {
        let written = match self.defined.get(name) {
            None => return self.frames.clone().filter(|_| name == "frames"),
            Some(Definition::Known(number)) => return Some(Arc::clone(number)),
            Some(Definition::Open) => None,
            Some(Definition::Written(range)) => Some(range.clone()),
        };
        let last = self.open.last().cloned();
        let Some(range) = written.filter(|_| self.open.len() <= MAX_CHAIN) else {
            // The fault is at the number that names this one.
            let at = last.and_then(|last| self.key_of(&last)).unwrap_or(0);
            let cycle: Vec<&str> = self.open.iter().map(String::as_str).skip_while(|open| *open != name).collect();
            let message = if cycle.is_empty() {
                format!("is computed through more than {MAX_CHAIN} other numbers: use fewer")
            } else {
                format!("is computed from itself ({} → {name}): break this cycle", cycle.join(" → "))
            };
            faults.insert((at, message));
            return Some(stand_in());
        };
        self.defined.insert(name.to_owned(), Definition::Open);
        self.open.push(name.to_owned());
        let number = self.compute(&range, faults);
        self.open.pop();
        self.defined.insert(name.to_owned(), Definition::Known(Arc::clone(&number)));
        Some(number)
    }

    fn key_of(&self, name: &str) -> Option<usize> {
        self.keys.iter().find(|key| scan::string(self.text, key) == name).map(|key| key.start)
    }

    fn compute(&mut self, range: &Range<usize>, faults: &mut BTreeSet<(usize, String)>) -> Arc<Expr> {
        let Some(string) = scan::formula_or_string(self.text, range) else {
            // An error in a track is found when the scene is parsed.
            return number(&self.text[range.clone()]).unwrap_or_else(stand_in);
        };
        let text = scan::string(self.text, &string);
        let formula = formula::parse(&text).and_then(|syntax| formula::resolve(&syntax, &mut InScene(self, faults)));
        formula.unwrap_or_else(|error| {
            faults.insert((scan::offset_in_string(self.text, &string, error.at), error.message));
            stand_in()
        })
    }
}

/// "the number of frames", but "3.14".
fn the(about: &str) -> String {
    if about.starts_with(|first: char| first.is_ascii_digit()) { about.to_owned() } else { format!("the {about}") }
}

/// A number, or a track, as written.
pub(super) fn number(text: &str) -> Option<Arc<Expr>> {
    if let Ok(number) = serde_json::from_str::<f32>(text) {
        return Some(Arc::new(Expr::Number(number)));
    }
    let track = serde_json::from_str::<Track>(text).ok()?;
    Some(Arc::new(Expr::Track(Arc::new(track))))
}
