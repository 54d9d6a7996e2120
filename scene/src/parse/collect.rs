//! Every fault of a job's text, not only the first that serde meets.
//!
//! A text with a fault of form is read in parts: the job without what is in its lists, then each object, node,
//! named material and light by itself. Where a part has a fault, the fault is noted, something valid stands in
//! for what is wrong, and the part is read again. The part is small, so that this takes long for no text, and its
//! bytes are counted, so that it ends for every text. What remains is sound in form, and is asked what it means;
//! what may be wrong only because of what stands in is not told.

mod repair;

use std::collections::HashSet;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::depends::is_sure;
use super::form::{self, FormError, FormErrorKind};
use super::stand_ins;
use super::tree::{self, TreeError, Value};
use super::{MAX_ERRORS, too_deep, twice};
use crate::document::JobDocument;
use crate::error::{LineIndex, ValidationError};
use crate::json_scan::unescape;
use crate::lights::Light;
use crate::materials::Material;
use crate::nodes::Node;
use crate::scene::Object;

/// Bytes that are read again to look for more faults, of all parts together.
const MAX_READ_BYTES: usize = 32 << 20;
/// What reading a part costs at least, in bytes.
const MIN_READ_BYTES: usize = 256;

/// A part of a job that is read by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DocumentPart {
    /// The job, without its objects, materials and lights.
    Job,
    /// An object, without its shape.
    Object,
    /// A node, without those inside.
    Node,
    Material,
    Light,
}

impl DocumentPart {
    /// The first fault of a text that should be such a part.
    fn read(self, text: &str) -> Result<(), FormError> {
        fn read<T: DeserializeOwned + Serialize>(text: &str) -> Result<(), FormError> {
            form::read_strictly::<T>(text).map(drop)
        }
        match self {
            Self::Job => read::<JobDocument>(text),
            Self::Object => read::<Object>(text),
            Self::Node => read::<Node>(text),
            Self::Material => read::<Material>(text),
            Self::Light => read::<Light>(text),
        }
    }

    /// A sound one.
    fn stand_in(self) -> &'static str {
        match self {
            Self::Job => stand_ins::JOB,
            Self::Object => stand_ins::OBJECT,
            Self::Node => stand_ins::NODE,
            Self::Material => stand_ins::MATERIAL,
            Self::Light => stand_ins::LIGHT,
        }
    }

    /// What stands in, while it is read, for a value in it that is read by itself.
    fn cut(self, path: &[String], value: &Value) -> Option<&'static str> {
        let path: Vec<&str> = path.iter().map(String::as_str).collect();
        let of_list = |json| match &value.body {
            tree::Body::Array(entries) if !entries.is_empty() => Some(json),
            _ => None,
        };
        match (self, path.as_slice()) {
            (Self::Job, ["scene", "objects"]) => of_list(stand_ins::OBJECTS),
            (Self::Job, ["scene", "lights"]) => of_list("[]"),
            (Self::Job, ["scene", "materials"]) => (!value.members().is_empty()).then_some("{}"),
            (Self::Object, ["shape"]) | (Self::Node, [_, "child"]) => Some(stand_ins::NODE),
            (Self::Node, [_, "of"]) => of_list(stand_ins::NODES),
            _ => None,
        }
    }

    /// The paths in a value to what is read by itself.
    fn inside(self, value: &Value) -> Vec<(Self, Vec<usize>)> {
        let below = |steps: &[&str], part: Self| {
            let steps: Vec<String> = steps.iter().map(ToString::to_string).collect();
            let (path, is_whole) = value.path_of(&steps);
            is_whole.then_some((part, path))
        };
        let entries = |steps: &[&str], part: Self| {
            let list = below(steps, part).map(|(_, path)| path);
            list.into_iter().flat_map(move |path| {
                let count = match value.at(&path).map(|list| &list.body) {
                    Some(tree::Body::Array(entries)) => entries.len(),
                    Some(tree::Body::Object(members)) if part == Self::Material => members.len(),
                    _ => 0,
                };
                (0..count).map(move |index| (part, [path.as_slice(), &[index]].concat()))
            })
        };
        match self {
            Self::Job => entries(&["scene", "objects"], Self::Object)
                .chain(entries(&["scene", "materials"], Self::Material))
                .chain(entries(&["scene", "lights"], Self::Light))
                .collect(),
            Self::Object => below(&["shape"], Self::Node).into_iter().collect(),
            Self::Node => match value.members() {
                [node] => below(&[&node.read_as, "child"], Self::Node)
                    .into_iter()
                    .chain(entries(&[&node.read_as, "of"], Self::Node))
                    .collect(),
                _ => Vec::new(),
            },
            Self::Material | Self::Light => Vec::new(),
        }
    }
}

/// A fault, and where it is.
struct CollectedErrors {
    pointer: String,
    offset: usize,
    message: String,
    /// Whether all in it is left out, and has no faults of its own.
    is_left_out: bool,
}

/// Looks for all faults.
struct Collector<'a> {
    text: &'a str,
    root: Value,
    found: Vec<CollectedErrors>,
    /// Pointers and messages of what is not told again.
    told: HashSet<(String, String)>,
    /// Pointers, as they are read, of what something stands in for.
    repaired: Vec<String>,
    /// Bytes that were read again.
    bytes_read: usize,
}

/// All faults of a text that is sound JSON, in the order of their places; none if it is a sound job.
///
/// `meaning` gives pointer and message of what is wrong with a text that is sound in form.
pub(super) fn all(text: &str, meaning: impl Fn(&str) -> Vec<(String, String)>) -> Vec<ValidationError> {
    let mut collector = Collector::new(text);
    collector.part(DocumentPart::Job, &[]);
    if collector.can_continue() {
        collector.meaning(meaning);
    }
    collector.faults()
}

/// All faults of form, and the bytes that were read to find them.
#[cfg(test)]
pub(super) fn counted(text: &str) -> (Vec<ValidationError>, usize) {
    let mut collector = Collector::new(text);
    collector.part(DocumentPart::Job, &[]);
    let read = collector.bytes_read;
    (collector.faults(), read)
}

impl<'a> Collector<'a> {
    fn new(text: &'a str) -> Self {
        let (root, misfits) = tree::read(text, MAX_ERRORS);
        let (found, told, repaired) = (Vec::new(), HashSet::new(), Vec::new());
        let mut collector = Self { text, root, found, told, repaired, bytes_read: 0 };
        collector.outline(misfits);
        collector
    }

    fn can_continue(&self) -> bool {
        self.found.len() < MAX_ERRORS && self.bytes_read < MAX_READ_BYTES.saturating_add(self.text.len())
    }

    fn outline(&mut self, misfits: Vec<TreeError>) {
        for misfit in misfits {
            let (path, offset, message) = match misfit {
                TreeError::DuplicateMember { path, start } => {
                    let key = self.root.member_at(&path).map(|member| member.key.clone()).unwrap_or_default();
                    (path, start, twice(&key))
                }
                TreeError::TooDeep { path, start } => (path, start, too_deep()),
            };
            let pointer = self.root.pointer(&path, false);
            self.found.push(CollectedErrors { pointer, offset, message, is_left_out: false });
        }
    }

    /// Reads a part and those in it.
    fn part(&mut self, part: DocumentPart, path: &[usize]) {
        let mut known = HashSet::new();
        for (part, path) in self.inside(part, path) {
            self.part(part, &path);
            known.insert(path);
        }
        for _ in 0..MAX_ERRORS {
            if !self.can_continue() {
                return;
            }
            match self.read(part, path) {
                Ok(()) => break,
                Err(fault) => self.repair(part, path, &fault),
            }
        }
        // A key that was mended may have more in it.
        for (part, path) in self.inside(part, path) {
            if !known.contains(&path) {
                self.part(part, &path);
            }
        }
    }

    fn inside(&self, part: DocumentPart, path: &[usize]) -> Vec<(DocumentPart, Vec<usize>)> {
        let Some(value) = self.root.at(path) else { return Vec::new() };
        let below = part.inside(value).into_iter();
        below.map(|(part, below)| (part, [path, &below].concat())).collect()
    }

    /// The first fault of a part, as it is with its repairs.
    fn read(&mut self, part: DocumentPart, path: &[usize]) -> Result<(), FormError> {
        let Some(value) = self.root.at(path) else { return Ok(()) };
        let mut text = String::new();
        value.write(self.text, &mut text, &mut Vec::new(), &|path, value| part.cut(path, value));
        self.bytes_read += text.len().max(MIN_READ_BYTES);
        part.read(&text)
    }

    /// Tells a fault of the form of what `path` leads to, unless it is known.
    fn tell(&mut self, path: &[usize], fault: &FormError) {
        if !self.told.insert((self.root.pointer(path, true), fault.message.clone())) {
            return;
        }
        let key = self.root.member_at(path).filter(|_| fault.is_key).map(|member| member.start);
        let Some(offset) = key.or_else(|| self.root.at(path).map(|value| value.start)) else { return };
        self.found.push(CollectedErrors {
            pointer: self.root.pointer(path, false),
            offset,
            message: fault.message.clone(),
            is_left_out: matches!(fault.kind, FormErrorKind::UnknownKey(_)),
        });
    }

    /// Asks the repaired job what it means.
    fn meaning(&mut self, meaning: impl Fn(&str) -> Vec<(String, String)>) {
        let mut text = String::new();
        self.root.write(self.text, &mut text, &mut Vec::new(), &|_, _| None);
        if form::read::<JobDocument>(&text).is_err() {
            return;
        }
        for (pointer, message) in meaning(&text) {
            if !is_sure(&pointer, &self.repaired) {
                continue;
            }
            let (path, _) = self.root.path_of(&steps(&pointer));
            let Some(value) = self.root.at(&path) else { continue };
            let (pointer, offset) = (self.root.pointer(&path, false), value.start);
            self.found.push(CollectedErrors { pointer, offset, message, is_left_out: false });
        }
    }

    /// What was found, in order.
    fn faults(mut self) -> Vec<ValidationError> {
        let left_out: Vec<String> =
            self.found.iter().filter(|found| found.is_left_out).map(|found| format!("{}/", found.pointer)).collect();
        self.found.retain(|found| !left_out.iter().any(|place| found.pointer.starts_with(place)));
        self.found.sort_by_key(|found| found.offset);
        self.found.truncate(MAX_ERRORS);
        let lines = LineIndex::new(self.text);
        let place = |found: CollectedErrors| lines.fault(found.offset, found.pointer, found.message);
        self.found.into_iter().map(place).collect()
    }
}

/// The parts of a JSON pointer.
fn steps(pointer: &str) -> Vec<String> {
    pointer.split('/').skip(1).map(unescape).collect()
}
