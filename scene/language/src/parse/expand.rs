//! Replaces formulas, uses of shapes with numbers, and counted copies by what they stand for, in the tree of a job.
//!
//! The result is a job without names of numbers: every formula that does not depend on time is a number, any other is a
//! list of steps (`picture::values::formula`), each use of a shape with numbers of its own names a shape of its own, and placements
//! that count copies are a list. The rest is copied. Each node of the result knows what it stands for in the user's text.

mod expanded;
mod names;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;
use std::sync::Arc;

pub(super) use self::expanded::Expanded;
pub(super) use self::names::Numbers;
use self::names::Scope;
use super::MAX_ERRORS;
use super::names::nearest_name;
use crate::json::{Builder, Kind, Tree, Value};
use crate::limits::{MAX_BODY_BYTES, MAX_NODE_DEPTH, MAX_NODES};
use crate::values::formula::{Expr, Syntax};

/// Maximum number of different uses of shapes with numbers.
pub(super) const MAX_INSTANCES: usize = 10_000;

/// Replaces formulas in a tree.
pub(super) fn expand<'t>(tree: &'t Tree<'t>) -> Expanded<'t> {
    let mut expander = Expander::new(tree);
    expander.job();
    let Expander { out, length, instances, faults, is_too_large, .. } = expander;
    let instances = instances.into_iter().filter(|(name, instance)| *name != instance.shape);
    let instances = instances.map(|(name, instance)| (name, instance.shape)).collect();
    Expanded { tree: out.finish(length), instances, is_too_large, faults: faults.into_iter().collect() }
}

/// A shape with numbers of its own.
#[derive(Clone, Debug)]
struct Instance {
    /// Name of the shape.
    shape: String,
    /// Its own numbers.
    with: BTreeMap<String, Arc<Expr>>,
    /// Byte offset of the key of each number.
    keys: BTreeMap<String, usize>,
    /// Names of the shapes around it that have numbers of their own, too.
    inside: Vec<String>,
}

/// Where the named shapes belong in the result: the number of nodes before them, and the index of the scene.
#[derive(Clone, Copy)]
struct ShapesAt<'t> {
    at: usize,
    scene_at: usize,
    key: Value<'t>,
    value: Value<'t>,
}

struct Expander<'t> {
    tree: &'t Tree<'t>,
    out: Builder<'t>,
    /// Length of the result as text, for the limit's message.
    length: usize,
    /// Byte offset of what is not in the length yet.
    pending: usize,
    /// Index of the scene in the result.
    scene_at: usize,
    /// Where the named shapes belong in the result.
    shapes_at: Option<ShapesAt<'t>>,
    numbers: Numbers<'t>,
    /// The named shapes: their keys and values.
    shapes: BTreeMap<String, (Value<'t>, Value<'t>)>,
    /// Shapes in use by their names in the result.
    instances: BTreeMap<String, Instance>,
    /// Named shapes that are in use.
    used: BTreeSet<String>,
    /// Names in `instances` whose shapes are not written yet.
    to_write: Vec<String>,
    /// Names in `instances` by shape and numbers.
    by_numbers: HashMap<String, String>,
    faults: BTreeSet<(usize, String)>,
    /// Parsed formulas of copies and of shapes, by their byte offsets.
    parsed: HashMap<usize, Result<Arc<Syntax>, ()>>,
    is_too_large: bool,
}

/// Where in a job a value is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ExpansionSite {
    Job,
    Scene,
    /// The parameters of `copies`.
    Copies,
    Elsewhere,
}

impl<'t> Expander<'t> {
    fn new(tree: &'t Tree<'t>) -> Self {
        let shapes = tree.root().get("scene").and_then(|scene| scene.get("shapes"));
        let shapes = shapes.into_iter().flat_map(Value::members);
        let shapes = shapes.map(|(key, value)| (key.string().into_owned(), (key, value))).collect();
        Self {
            tree,
            out: Builder::new(tree),
            length: 0,
            pending: 0,
            scene_at: 0,
            shapes_at: None,
            numbers: Numbers::new(tree.root()),
            shapes,
            instances: BTreeMap::new(),
            used: BTreeSet::new(),
            to_write: Vec::new(),
            by_numbers: HashMap::new(),
            faults: BTreeSet::new(),
            parsed: HashMap::new(),
            is_too_large: false,
        }
    }

    fn job(&mut self) {
        self.numbers.resolve_all(&mut self.faults);
        let no_names = BTreeMap::new();
        self.value(self.tree.root(), &mut Scope::new(&no_names), ExpansionSite::Job, &[]);
        self.skip_to(self.tree.text().len());
        if let Some(ShapesAt { at, scene_at, key, value }) = self.shapes_at {
            let rest = self.out.split_off(at);
            self.write_shapes(key, value);
            self.out.append(rest, &[0, scene_at]);
        }
    }

    fn fault(&mut self, at: usize, message: impl Into<String>) {
        if self.faults.len() < MAX_ERRORS {
            self.faults.insert((at, message.into()));
        }
    }

    /// Adds what is not replaced, up to a byte of the user's text, to the length.
    fn skip_to(&mut self, to: usize) {
        self.length += to.saturating_sub(self.pending);
        self.pending = to;
        if self.length > 2 * MAX_BODY_BYTES && !self.is_too_large {
            self.is_too_large = true;
            let limit = (2 * MAX_BODY_BYTES) >> 20;
            self.fault(0, format!("is larger than {limit} MiB with its formulas replaced: use fewer copies or shapes"));
        }
    }

    /// Replaces a value by JSON.
    fn replace(&mut self, value: Value<'t>, with: &str) {
        self.skip_to(value.start());
        self.length += with.len();
        self.pending = value.end();
        self.out.json(with, value.start());
    }

    /// Copies a value, and replaces what is in it. `inside` are the shapes around it.
    fn value(&mut self, value: Value<'t>, scope: &mut Scope<'_>, place: ExpansionSite, inside: &[String]) {
        if self.is_too_large {
            return;
        }
        let is_walked = place == ExpansionSite::Job || place == ExpansionSite::Scene || value.has_language_keys();
        match value.kind() {
            Kind::Object if is_walked => self.object(value, scope, place, inside),
            Kind::Array if is_walked => {
                self.out.open(value);
                for entry in value.entries() {
                    self.value(entry, scope, ExpansionSite::Elsewhere, inside);
                }
                self.out.close(value);
            }
            Kind::Object | Kind::Array | Kind::String | Kind::Number | Kind::Word => self.out.copy(value),
        }
    }

    fn object(&mut self, object: Value<'t>, scope: &mut Scope<'_>, place: ExpansionSite, inside: &[String]) {
        if let Some(formula) = formula(object) {
            let number = self.formula(formula, scope);
            self.replace(object, &json(&number));
            return;
        }
        self.out.open(object);
        for (key, value) in object.members() {
            match (place, key.raw()) {
                (ExpansionSite::Scene, "shapes") if value.kind() == Kind::Object && self.shapes_at.is_none() => {
                    // They are written once it is known which are used how.
                    self.skip_to(value.start());
                    self.shapes_at = Some(ShapesAt { at: self.out.len(), scene_at: self.scene_at, key, value });
                    self.pending = value.end();
                    continue;
                }
                _ => self.out.copy(key),
            }
            match (place, key.raw()) {
                (ExpansionSite::Job, "scene") => {
                    self.scene_at = self.out.len();
                    self.value(value, scope, ExpansionSite::Scene, inside);
                }
                (ExpansionSite::Scene, "numbers" | "shapes") => self.out.copy(value),
                (_, "use") => self.used(value, scope, inside),
                (ExpansionSite::Copies, "at") if is_counted(value) => self.counted(value, scope, inside),
                (_, "copies") => self.value(value, scope, ExpansionSite::Copies, inside),
                (ExpansionSite::Copies, "child") => {
                    let is_counted = object.get("at").is_some_and(is_counted);
                    let was_copied = std::mem::replace(&mut scope.is_copied, is_counted);
                    self.value(value, scope, ExpansionSite::Elsewhere, inside);
                    scope.is_copied = was_copied;
                }
                _ => self.value(value, scope, ExpansionSite::Elsewhere, inside),
            }
        }
        self.out.close(object);
    }

    /// The value of the formula in a string.
    fn formula(&mut self, string: Value<'t>, scope: &mut Scope<'_>) -> Arc<Expr> {
        // Other formulas are read once.
        let is_repeated = scope.copy().is_some() || scope.is_in_shape;
        let parsed = self.parsed.get(&string.start()).filter(|_| is_repeated).cloned();
        let parsed = parsed.unwrap_or_else(|| {
            let parsed = crate::values::formula::parse(&string.string()).map(Arc::new);
            let parsed = parsed.map_err(|error| {
                self.fault(offset_in_string(string, error.at), error.message);
            });
            if is_repeated {
                self.parsed.insert(string.start(), parsed.clone());
            }
            parsed
        });
        let Ok(syntax) = parsed else { return stand_in() };
        let resolved = crate::values::formula::resolve(&syntax, &mut scope.names(&mut self.numbers, &mut self.faults));
        resolved.unwrap_or_else(|error| {
            let at = offset_in_string(string, error.at);
            // A formula of counted copies is reported once, for the first copy for which it is wrong.
            let is_reported =
                scope.copy().is_some() && self.faults.range((at, String::new())..).any(|reported| reported.0 == at);
            let copy = scope.copy().filter(|_| error.message.contains("no finite value"));
            let copy = copy.map(|copy| format!(" (for the copy i = {copy})")).unwrap_or_default();
            if !is_reported {
                self.fault(at, error.message + &copy);
            }
            stand_in()
        })
    }

    /// Replaces the value of a `use` if it has numbers.
    fn used(&mut self, value: Value<'t>, scope: &mut Scope<'_>, inside: &[String]) {
        if value.kind() == Kind::String {
            self.plain_use(&value.string());
        }
        let parts = value.get("shape").zip(value.get("with"));
        let Some((shape, with)) =
            parts.filter(|(shape, with)| shape.kind() == Kind::String && with.kind() == Kind::Object)
        else {
            self.out.copy(value);
            return;
        };
        let shape = shape.string().into_owned();
        let (mut numbers, mut keys) = (BTreeMap::new(), BTreeMap::new());
        for (key, given) in with.members() {
            let number = match formula_or_string(given) {
                Some(formula) => Some(self.formula(formula, scope)),
                None => names::number(given),
            };
            let number = number.unwrap_or_else(|| {
                let message = "must be a number, a formula as text, or a track";
                self.fault(given.start(), message);
                stand_in()
            });
            keys.insert(key.string().into_owned(), key.start());
            numbers.insert(key.string().into_owned(), number);
        }
        if !self.shapes.contains_key(&shape) {
            self.replace(value, &quoted(&shape));
            return;
        }
        if inside.len() == MAX_NODE_DEPTH {
            self.fault(value.start(), format!("nests uses with numbers deeper than {MAX_NODE_DEPTH}: nest fewer"));
            self.replace(value, "null");
            return;
        }
        if inside.contains(&shape) {
            let path: Vec<String> = inside.iter().chain([&shape]).map(|name| format!("\"{name}\"")).collect();
            let message =
                format!("makes \"{shape}\" a part of itself ({}): remove one of these uses", path.join(" → "));
            self.fault(value.start(), message);
            self.replace(value, "null");
            return;
        }
        let name = self.instance(&shape, numbers, keys, inside, value.start());
        self.replace(value, &quoted(&name));
    }

    fn plain_use(&mut self, name: &str) {
        if !self.shapes.contains_key(name) || self.instances.contains_key(name) {
            return;
        }
        let (with, keys) = (BTreeMap::new(), BTreeMap::new());
        let instance = Instance { shape: name.to_owned(), with, keys, inside: Vec::new() };
        self.instances.insert(name.to_owned(), instance);
        self.used.insert(name.to_owned());
        self.to_write.push(name.to_owned());
    }

    /// Name of a shape with numbers of its own.
    fn instance(
        &mut self,
        shape: &str,
        with: BTreeMap<String, Arc<Expr>>,
        keys: BTreeMap<String, usize>,
        inside: &[String],
        at: usize,
    ) -> String {
        let numbers: Vec<String> = with.iter().map(|(name, number)| format!("{name}={}", json(number))).collect();
        let id = format!("{}({})", quoted(shape), numbers.join(","));
        if let Some(name) = self.by_numbers.get(&id) {
            return name.clone();
        }
        if self.by_numbers.len() == MAX_INSTANCES {
            let message = format!("is one of more than {MAX_INSTANCES} shapes with different numbers: use fewer");
            self.fault(at, message);
            self.plain_use(shape);
            return shape.to_owned();
        }
        let short = |(name, number): (&String, &Arc<Expr>)| match number.constant() {
            Some(number) => format!("{name}={number}"),
            None => format!("{name}=…"),
        };
        let mut name = format!("{shape}({})", with.iter().map(short).collect::<Vec<_>>().join(", "));
        while self.shapes.contains_key(&name) || self.instances.contains_key(&name) {
            name.push('\'');
        }
        let instance = Instance { shape: shape.to_owned(), with, keys, inside: inside.to_vec() };
        self.instances.insert(name.clone(), instance);
        self.used.insert(shape.to_owned());
        self.by_numbers.insert(id, name.clone());
        self.to_write.push(name.clone());
        name
    }

    /// Writes the named shapes: each that is used without numbers or not at all, and one for each different use with
    /// numbers.
    fn write_shapes(&mut self, key: Value<'t>, written: Value<'t>) {
        let from = written.start();
        self.out.copy(key);
        self.out.open_made("{", from);
        self.length += "{}".len();
        let (mut separator, mut next) = ("", 0);
        let mut others = self.shapes.keys().cloned().collect::<Vec<_>>().into_iter();
        loop {
            while let Some(name) = self.to_write.get(next).cloned() {
                next += 1;
                self.length += separator.len();
                self.write_shape(&name);
                separator = ",";
            }
            // Shapes that are not used at all are checked, too.
            let Some(other) = others.next().filter(|_| !self.is_too_large) else { break };
            if !self.used.contains(&other) {
                self.plain_use(&other);
            }
        }
        self.out.close_made("}", from);
    }

    fn write_shape(&mut self, name: &str) {
        let Some(Instance { shape, with, keys, mut inside }) = self.instances.get(name).cloned() else { return };
        let Some((key, value)) = self.shapes.get(&shape).copied() else { return };
        let name = quoted(name);
        self.out.key(&name, key.start());
        self.length += name.len() + 1;
        self.pending = value.start();
        if !with.is_empty() {
            inside.push(shape.clone());
        }
        let mut scope = Scope::new(&with);
        scope.is_in_shape = true;
        self.value(value, &mut scope, ExpansionSite::Elsewhere, &inside);
        self.skip_to(value.end());
        let asked = scope.asked;
        for (number, at) in keys.iter().filter(|(number, _)| !asked.contains(*number)) {
            let known: Vec<&str> = asked.iter().map(String::as_str).collect();
            let meant = nearest_name(number, &known).map(|meant| format!("; did you mean \"{meant}\"?"));
            let meant = meant.unwrap_or_default();
            self.fault(*at, format!("is in no formula of \"{shape}\": remove it, or use it there{meant}"));
        }
    }

    /// Writes placements that count copies, as a list.
    fn counted(&mut self, written: Value<'t>, scope: &mut Scope<'_>, inside: &[String]) {
        let from = written.start();
        let Some(count_at) = written.get("count") else { return self.out.copy(written) };
        let count = match formula(count_at) {
            Some(formula) => self.formula(formula, scope).constant(),
            None => count_at.text().parse().ok(),
        };
        let Some(whole) = count.filter(|count| count.fract() == 0.0 && (1.0..=MAX_NODES as f32).contains(count)) else {
            let written_count = count.map(|count| format!(", not {count}")).unwrap_or_default();
            self.fault(
                count_at.start(),
                format!(
                    "must be a whole number of copies from 1 to {MAX_NODES}, the same in all frames{written_count}"
                ),
            );
            self.replace(written, "[{}]");
            return;
        };
        let count = whole as u32;
        self.skip_to(from);
        self.length += "[]".len();
        self.out.open_made("[", from);
        let own: Vec<_> = written.members().filter(|(key, _)| key.raw() != "count").collect();
        for index in 0..count {
            self.length += if index == 0 { "{}".len() } else { ",{}".len() };
            self.out.open_made("{", from);
            for (place, (key, value)) in own.iter().enumerate() {
                self.length += usize::from(place > 0);
                self.pending = key.start();
                self.out.copy(*key);
                scope.counting(index, count, |scope| self.value(*value, scope, ExpansionSite::Elsewhere, inside));
                self.skip_to(value.end());
            }
            self.out.close_made("}", from);
            if self.is_too_large {
                break;
            }
        }
        self.out.close_made("]", from);
        self.pending = written.end();
    }
}

/// Stand-in for a wrong formula.
fn stand_in() -> Arc<Expr> {
    Arc::new(Expr::Number(1.0))
}

/// A formula's value as JSON: a number, or steps.
fn json(value: &Expr) -> String {
    value.constant().map_or_else(
        || format!("{{\"expr\":{}}}", serde_json::to_string(&value.to_steps()).unwrap_or_default()),
        |number| number.to_string(),
    )
}

fn quoted(text: &str) -> String {
    let mut quoted = String::new();
    let _ = write!(quoted, "{}", serde_json::Value::from(text));
    quoted
}

/// The string of `{ "expr": string }`, if this is the value.
pub(super) fn formula(value: Value<'_>) -> Option<Value<'_>> {
    let mut members = value.members();
    let (key, string) = members.next()?;
    (key.raw() == "expr" && string.kind() == Kind::String && members.next().is_none()).then_some(string)
}

/// The string of a formula, or a string alone.
pub(super) fn formula_or_string(value: Value<'_>) -> Option<Value<'_>> {
    if value.kind() == Kind::String { Some(value) } else { formula(value) }
}

/// Whether placements count their copies: they are an object with a count, but not along a line.
pub(super) fn is_counted(value: Value<'_>) -> bool {
    value.get("count").is_some() && value.get("along").is_none()
}

/// Byte offset in the text of an offset in what a string stands for.
fn offset_in_string(string: Value<'_>, offset: usize) -> usize {
    let (mut parsed, mut rest) = (0, string.raw());
    while parsed < offset && !rest.is_empty() {
        let length = match rest.as_bytes() {
            [b'\\', b'u', ..] => 6,
            [b'\\', ..] => 2,
            _ => rest.chars().next().map_or(1, char::len_utf8),
        };
        let (character, after) = rest.split_at(length.min(rest.len()));
        let is_escape = character.starts_with('\\');
        let unescaped =
            || serde_json::from_str::<String>(&format!("\"{character}\"")).map_or(1, |text| text.len().max(1));
        parsed += if is_escape { unescaped() } else { character.len() };
        rest = after;
    }
    string.end() - 1 - rest.len()
}
