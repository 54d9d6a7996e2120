//! Collects every error of a job's text, not only the first one that serde reports.
//!
//! A text with an error of form is parsed in parts: the job without the contents of its lists, then each object, node,
//! named material and light separately. If a part has an error, the error is recorded, a valid stand-in replaces the
//! invalid value, and the part is parsed again. Parts are small, so this is fast, and the number of parsed bytes is
//! limited, so it ends for every text. The repaired job is valid in form, and is then validated for its meaning.
//! Errors that may be caused only by a stand-in are not reported.

mod repair;

use std::collections::HashSet;

use serde::de::DeserializeOwned;

use super::depends::is_sure;
use super::form::{self, FormError, FormErrorKind};
use super::stand_ins;
use super::tree::{self, TreeError, Value};
use super::{MAX_ERRORS, too_deep, twice};
use crate::document::JobDocument;
use crate::error::Fault;
use crate::json::{self, Tree};
use crate::json_text::unescape;
use crate::lights::Light;
use crate::materials::Material;
use crate::nodes::Node;
use crate::scene::Object;

/// Maximum number of bytes parsed again to find more errors, of all parts together.
const MAX_READ_BYTES: usize = 32 << 20;
/// Maximum number of values of a text that is repaired: a value takes up to 170 bytes of memory.
const MAX_VALUES: usize = 1_500_000;
/// Minimum cost of parsing a part, in bytes.
const MIN_READ_BYTES: usize = 256;

/// A part of a job that is parsed separately.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DocumentPart {
    /// The job, without its objects, shapes, materials and lights.
    Job,
    /// An object, without its shape.
    Object,
    /// A node, without its child nodes.
    Node,
    Material,
    Light,
}

impl DocumentPart {
    /// The first error of a tree that should be such a part.
    fn read(self, tree: &Tree<'_>) -> Result<(), FormError> {
        fn read<T: DeserializeOwned>(tree: &Tree<'_>) -> Result<(), FormError> {
            form::read::<T>(tree).map(drop)
        }
        match self {
            Self::Job => read::<JobDocument>(tree),
            Self::Object => read::<Object>(tree),
            Self::Node => read::<Node>(tree),
            Self::Material => read::<Material>(tree),
            Self::Light => read::<Light>(tree),
        }
    }

    /// A valid part of this kind.
    fn stand_in(self) -> &'static str {
        match self {
            Self::Job => stand_ins::JOB,
            Self::Object => stand_ins::OBJECT,
            Self::Node => stand_ins::NODE,
            Self::Material => stand_ins::MATERIAL,
            Self::Light => stand_ins::LIGHT,
        }
    }

    /// Stand-in for a value in the part that is parsed separately.
    fn cut(self, path: &[String], value: &Value) -> Option<&'static str> {
        let path: Vec<&str> = path.iter().map(String::as_str).collect();
        let of_list = |json| match &value.body {
            tree::Body::Array(entries) if !entries.is_empty() => Some(json),
            _ => None,
        };
        match (self, path.as_slice()) {
            (Self::Job, ["scene", "objects"]) => of_list(stand_ins::OBJECTS),
            (Self::Job, ["scene", "lights"]) => of_list("[]"),
            (Self::Job, ["scene", "materials" | "shapes"]) => (!value.members().is_empty()).then_some("{}"),
            (Self::Object, ["shape"]) | (Self::Node, [_, "child" | "on"]) => Some(stand_ins::NODE),
            (Self::Node, [_, "of"]) => of_list(stand_ins::NODES),
            _ => None,
        }
    }

    /// Paths in a value to the parts that are parsed separately.
    fn inside(self, value: &Value) -> Vec<(Self, Vec<usize>)> {
        let below = |steps: &[&str], part: Self| {
            let steps: Vec<String> = steps.iter().map(ToString::to_string).collect();
            let (path, is_whole) = value.path_of(&steps);
            is_whole.then_some((part, path))
        };
        let entries = |steps: &[&str], part: Self| {
            let is_by_name = matches!(steps.last(), Some(&("materials" | "shapes")));
            let list = below(steps, part).map(|(_, path)| path);
            list.into_iter().flat_map(move |path| {
                let count = match value.at(&path).map(|list| &list.body) {
                    Some(tree::Body::Array(entries)) => entries.len(),
                    Some(tree::Body::Object(members)) if is_by_name => members.len(),
                    _ => 0,
                };
                (0..count).map(move |index| (part, [path.as_slice(), &[index]].concat()))
            })
        };
        match self {
            Self::Job => entries(&["scene", "objects"], Self::Object)
                .chain(entries(&["scene", "materials"], Self::Material))
                .chain(entries(&["scene", "shapes"], Self::Node))
                .chain(entries(&["scene", "lights"], Self::Light))
                .collect(),
            Self::Object => below(&["shape"], Self::Node).into_iter().collect(),
            Self::Node => match value.members() {
                [node] => below(&[&node.read_as, "child"], Self::Node)
                    .into_iter()
                    .chain(below(&[&node.read_as, "on"], Self::Node))
                    .chain(entries(&[&node.read_as, "of"], Self::Node))
                    .collect(),
                _ => Vec::new(),
            },
            Self::Material | Self::Light => Vec::new(),
        }
    }
}

/// An error, and its position.
struct CollectedErrors {
    pointer: String,
    /// Node of the key or the value.
    node: u32,
    message: String,
    /// Whether its whole content is left out, and has no errors of its own.
    is_left_out: bool,
}

/// Collector of all errors.
struct Collector<'a> {
    tree: &'a Tree<'a>,
    root: Value,
    found: Vec<CollectedErrors>,
    /// Pointers and messages that have been reported.
    reported: HashSet<(String, String)>,
    /// Pointers, in the repaired job, of values that have been replaced.
    repaired: Vec<String>,
    /// Bytes parsed again so far.
    bytes_read: usize,
}

/// All errors of a tree, in the order of their positions; none if it is a valid job, or if it has more values than can be
/// repaired in little memory.
///
/// `meaning` returns pointer and message of the semantic errors of a tree that is valid in form. Those are left out that
/// are not certain according to `is_certain`, which is given the pointer and the byte offset.
pub(super) fn all(
    tree: &Tree<'_>,
    meaning: impl Fn(&Tree<'_>) -> Vec<(String, String)>,
    is_certain: &dyn Fn(&str, usize) -> bool,
) -> Vec<Fault> {
    if tree.value_count() > MAX_VALUES {
        return Vec::new();
    }
    let mut collector = Collector::new(tree);
    collector.part(DocumentPart::Job, &[]);
    if collector.can_continue() {
        collector.meaning(meaning, is_certain);
    }
    collector.faults()
}

/// All errors of form, and the number of bytes parsed to find them.
#[cfg(test)]
pub(super) fn counted(tree: &Tree<'_>) -> (Vec<Fault>, usize) {
    let mut collector = Collector::new(tree);
    collector.part(DocumentPart::Job, &[]);
    let read = collector.bytes_read;
    (collector.faults(), read)
}

impl<'a> Collector<'a> {
    fn new(tree: &'a Tree<'a>) -> Self {
        let (root, misfits) = tree::read(tree, MAX_ERRORS);
        let (found, reported, repaired) = (Vec::new(), HashSet::new(), Vec::new());
        let mut collector = Self { tree, root, found, reported, repaired, bytes_read: 0 };
        collector.outline(misfits);
        collector
    }

    fn can_continue(&self) -> bool {
        self.found.len() < MAX_ERRORS && self.bytes_read < MAX_READ_BYTES.saturating_add(self.tree.length())
    }

    fn outline(&mut self, misfits: Vec<TreeError>) {
        for misfit in misfits {
            let (path, node, message) = match misfit {
                TreeError::DuplicateMember { path, node } => {
                    let key = self.root.member_at(&path).map(|member| member.key.clone()).unwrap_or_default();
                    (path, node, twice(&key))
                }
                TreeError::TooDeep { path, node } => (path, node, too_deep()),
            };
            let pointer = self.root.pointer(&path, false);
            self.found.push(CollectedErrors { pointer, node, message, is_left_out: false });
        }
    }

    /// Parses a part and the parts in it.
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
        // A renamed key may have more parts in it.
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

    /// The first error of a part with its repairs.
    fn read(&mut self, part: DocumentPart, path: &[usize]) -> Result<(), FormError> {
        let Some(value) = self.root.at(path) else { return Ok(()) };
        let tree = value.build(self.tree, &|path, value| part.cut(path, value));
        self.bytes_read += tree.length().max(MIN_READ_BYTES);
        part.read(&tree)
    }

    /// Reports an error of form at `path`, unless it has been reported.
    fn tell(&mut self, path: &[usize], fault: &FormError) {
        if !self.reported.insert((self.root.pointer(path, true), fault.message.clone())) {
            return;
        }
        let key = self.root.member_at(path).filter(|_| fault.is_key).map(|member| member.node);
        let Some(node) = key.or_else(|| self.root.at(path).map(|value| value.node)) else { return };
        self.found.push(CollectedErrors {
            pointer: self.root.pointer(path, false),
            node,
            message: fault.message.clone(),
            is_left_out: matches!(fault.kind, FormErrorKind::UnknownKey(_)),
        });
    }

    /// Validates the meaning of the repaired job.
    fn meaning(
        &mut self,
        meaning: impl Fn(&Tree<'_>) -> Vec<(String, String)>,
        is_certain: &dyn Fn(&str, usize) -> bool,
    ) {
        let tree = self.root.build(self.tree, &|_, _| None);
        if form::read::<JobDocument>(&tree).is_err() {
            return;
        }
        for (pointer, message) in meaning(&tree) {
            let has_use =
                |pointer: &str| self.root.at(&self.root.path_of(&steps(pointer)).0).is_none_or(Value::has_use);
            if !is_sure(&pointer, &self.repaired, &has_use) {
                continue;
            }
            let (path, _) = self.root.path_of(&steps(&pointer));
            let Some(value) = self.root.at(&path) else { continue };
            let (pointer, node) = (self.root.pointer(&path, false), value.node);
            if is_certain(&pointer, json::Value::of(self.tree, node).start()) {
                self.found.push(CollectedErrors { pointer, node, message, is_left_out: false });
            }
        }
    }

    /// The errors found, in the order of their positions.
    fn faults(mut self) -> Vec<Fault> {
        let left_out: Vec<String> =
            self.found.iter().filter(|found| found.is_left_out).map(|found| format!("{}/", found.pointer)).collect();
        self.found.retain(|found| !left_out.iter().any(|place| found.pointer.starts_with(place)));
        self.found.sort_by_key(|found| found.node);
        self.found.truncate(MAX_ERRORS);
        let place = |CollectedErrors { pointer, node, message, is_left_out: _ }: CollectedErrors| {
            let at = Some(json::Value::of(self.tree, node).start());
            Fault { pointer, message, at }
        };
        self.found.into_iter().map(place).collect()
    }
}

/// The parts of a JSON pointer.
fn steps(pointer: &str) -> Vec<String> {
    pointer.split('/').skip(1).map(unescape).collect()
}
