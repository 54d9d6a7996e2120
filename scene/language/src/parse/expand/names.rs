//! The numbers that names in formulas stand for: from the scene, a shape, and counted copies.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use serde::Deserialize;

use super::{formula_or_string, offset_in_string, stand_in};
use crate::json::Value;
use crate::values::formula::{self, Expr, FUNCTIONS, NAMES, Names, is_name};
use crate::values::track::Track;

/// Maximum number of numbers between a number and one that it is computed from.
const MAX_CHAIN: usize = 32;
/// Maximum number of named numbers.
const MAX_NUMBERS: usize = 10_000;

/// The numbers of a scene, by name.
#[derive(Debug)]
pub(in super::super) struct Numbers<'t> {
    defined: BTreeMap<String, Definition<'t>>,
    /// Keys of the numbers, in their order.
    keys: Vec<Value<'t>>,
    /// Number of frames of the job.
    frames: Option<Arc<Expr>>,
    /// Numbers that are being computed.
    open: Vec<String>,
}

#[derive(Clone, Debug)]
enum Definition<'t> {
    /// As written.
    Written(Value<'t>),
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
    pub(in super::super) fn new(job: Value<'t>) -> Self {
        let numbers = || job.get("scene").and_then(|scene| scene.get("numbers")).into_iter().flat_map(Value::members);
        let keys = numbers().map(|(key, _)| key).collect();
        let defined = numbers().map(|(key, value)| (key.string().into_owned(), Definition::Written(value))).collect();
        let count = match job.get("frames").and_then(|frames| frames.get("count")) {
            None => Some(1.0),
            Some(count) => count.text().parse().ok(),
        };
        let frames = count.map(|count| Arc::new(Expr::Number(count)));
        Self { defined, keys, frames, open: Vec::new() }
    }

    /// Computes all numbers, so that every error in them is found.
    pub(super) fn resolve_all(&mut self, faults: &mut BTreeSet<(usize, String)>) {
        if self.keys.len() > MAX_NUMBERS {
            let message = format!("is one of {} numbers: use at most {MAX_NUMBERS}", self.keys.len());
            faults.insert((self.keys[MAX_NUMBERS].start(), message));
            self.keys.truncate(MAX_NUMBERS);
        }
        for key in self.keys.clone() {
            let name = key.string();
            if !is_name(&name) {
                let message = "cannot be named in formulas: use letters, digits and _, the first not a digit";
                faults.insert((key.start(), message.to_owned()));
            } else if let Some((_, about)) = NAMES.iter().find(|(known, _)| *known == &*name) {
                faults.insert((key.start(), format!("stands for {}, in every formula: use another name", the(about))));
            } else if FUNCTIONS.iter().any(|function| function.name == &*name) {
                faults.insert((key.start(), "is the name of a function: use another".to_owned()));
            }
            self.get(&name, faults);
        }
    }

    fn get(&mut self, name: &str, faults: &mut BTreeSet<(usize, String)>) -> Option<Arc<Expr>> {
        let written = match self.defined.get(name) {
            None => return self.frames.clone().filter(|_| name == "frames"),
            Some(Definition::Known(number)) => return Some(Arc::clone(number)),
            Some(Definition::Open) => None,
            Some(Definition::Written(value)) => Some(*value),
        };
        let last = self.open.last().cloned();
        let Some(written) = written.filter(|_| self.open.len() <= MAX_CHAIN) else {
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
        let number = self.compute(written, faults);
        self.open.pop();
        self.defined.insert(name.to_owned(), Definition::Known(Arc::clone(&number)));
        Some(number)
    }

    /// Value of a formula that is the same in all frames and has only the scene's numbers.
    pub(in super::super) fn of_scene(&mut self, formula: Value<'t>) -> Option<f32> {
        let syntax = formula::parse(&formula.string()).ok()?;
        formula::resolve(&syntax, &mut InScene(self, &mut BTreeSet::new())).ok()?.constant()
    }

    fn key_of(&self, name: &str) -> Option<usize> {
        self.keys.iter().find(|key| key.string() == name).map(|key| key.start())
    }

    fn compute(&mut self, written: Value<'t>, faults: &mut BTreeSet<(usize, String)>) -> Arc<Expr> {
        let Some(string) = formula_or_string(written) else {
            // An error in a track is found when the scene is parsed.
            return number(written).unwrap_or_else(stand_in);
        };
        let text = string.string();
        let formula = formula::parse(&text).and_then(|syntax| formula::resolve(&syntax, &mut InScene(self, faults)));
        formula.unwrap_or_else(|error| {
            faults.insert((offset_in_string(string, error.at), error.message));
            stand_in()
        })
    }
}

/// "the number of frames", but "3.14".
fn the(about: &str) -> String {
    if about.starts_with(|first: char| first.is_ascii_digit()) { about.to_owned() } else { format!("the {about}") }
}

/// A number, or a track, as written.
pub(super) fn number(value: Value<'_>) -> Option<Arc<Expr>> {
    if let Ok(number) = f32::deserialize(value) {
        return Some(Arc::new(Expr::Number(number)));
    }
    let track = Track::deserialize(value).ok()?;
    Some(Arc::new(Expr::Track(Arc::new(track))))
}
