//! Replaces formulas, uses of shapes with numbers, and counted copies by what they stand for, in the text of a job.
//!
//! The result is a job without names of numbers: every formula that does not depend on time is a number, any other is a
//! list of steps (`picture::values::formula`), each use of a shape with numbers of its own names a shape of its own, and placements
//! that count copies are a list. The rest of the text is copied. [`Expanded`] remembers where each part came from, so
//! that errors in the result have their positions in the user's text.

mod expanded;
mod names;
pub(super) mod scan;
mod source;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;
use std::ops::Range;
use std::sync::Arc;

pub(super) use self::expanded::Expanded;
use self::names::{Numbers, Scope};
use self::scan::{end_of, members, skip_space, string_end};
use self::source::Source;
use super::MAX_ERRORS;
use crate::limits::{MAX_BODY_BYTES, MAX_NODE_DEPTH, MAX_NODES};
use crate::names::nearest_name;
use crate::values::formula::{Expr, Syntax};

/// Maximum number of different uses of shapes with numbers.
const MAX_INSTANCES: usize = 10_000;

/// Replaces formulas in a text that is valid JSON; `None` if it has none.
pub(super) fn expand(text: &str) -> Option<Expanded> {
    if !["\"expr\"", "\"numbers\"", "\"with\"", "\"count\""].iter().any(|key| text.contains(key)) {
        return None;
    }
    let mut expander = Expander::new(text);
    expander.job();
    let Expander { out, source, instances, faults, .. } = expander;
    let instances = instances.into_iter().filter(|(name, instance)| *name != instance.shape);
    let instances = instances.map(|(name, instance)| (name, instance.shape)).collect();
    Some(Expanded { text: out, instances, source, faults: faults.into_iter().collect() })
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

struct Expander<'t> {
    text: &'t str,
    out: String,
    source: Source,
    /// Byte offset of what is not copied yet.
    pending: usize,
    /// Where the named shapes belong in the result, and where they are in the text.
    shapes_at: Option<(usize, usize)>,
    numbers: Numbers<'t>,
    /// The named shapes: byte ranges of their keys and values.
    shapes: BTreeMap<String, (Range<usize>, Range<usize>)>,
    /// Shapes in use by their names in the result.
    instances: BTreeMap<String, Instance>,
    /// Named shapes that are in use.
    used: BTreeSet<String>,
    /// Names in `instances` whose shapes are not written yet.
    to_write: Vec<String>,
    /// Names in `instances` by shape and numbers.
    by_numbers: HashMap<String, String>,
    faults: BTreeSet<(usize, String)>,
    /// Parsed formulas by their byte offsets.
    parsed: HashMap<usize, Result<Arc<Syntax>, ()>>,
    is_too_large: bool,
}

/// Where in a job a value is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Job,
    Scene,
    /// The parameters of `copies`.
    Copies,
    Elsewhere,
}

impl<'t> Expander<'t> {
    fn new(text: &'t str) -> Self {
        let root = skip_space(text, 0);
        let scene = scan::member(text, root, "scene");
        let shapes = scene.and_then(|scene| scan::member(text, scene, "shapes"));
        let shapes = shapes.into_iter().flat_map(|shapes| members(text, shapes));
        let shapes = shapes.map(|(key, value)| (scan::string(text, &key), (key, value))).collect();
        Self {
            text,
            out: String::with_capacity(text.len()),
            source: Source::default(),
            pending: 0,
            shapes_at: None,
            numbers: Numbers::new(text, root, scene),
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
        let root = skip_space(self.text, 0);
        let no_names = BTreeMap::new();
        self.value(root, &mut Scope::new(&no_names), Place::Job, &[]);
        self.flush(self.text.len());
        if let Some((at, start)) = self.shapes_at {
            let (rest, rest_source) = (self.out.split_off(at), self.source.split_off(at));
            self.write_shapes(start);
            self.source.append(rest_source, self.out.len() - at);
            self.out.push_str(&rest);
        }
    }

    fn fault(&mut self, at: usize, message: impl Into<String>) {
        if self.faults.len() < MAX_ERRORS {
            self.faults.insert((at, message.into()));
        }
    }

    /// Copies the text up to a position.
    fn flush(&mut self, to: usize) {
        if self.pending < to {
            self.source.copied(self.out.len(), self.pending);
            self.out.push_str(&self.text[self.pending..to]);
        }
        self.pending = to;
        if self.out.len() > 2 * MAX_BODY_BYTES && !self.is_too_large {
            self.is_too_large = true;
            let limit = (2 * MAX_BODY_BYTES) >> 20;
            self.fault(0, format!("is larger than {limit} MiB with its formulas replaced: use fewer copies or shapes"));
        }
    }

    /// Replaces a part of the text.
    fn replace(&mut self, part: Range<usize>, with: &str) {
        self.flush(part.start);
        self.source.replaced(self.out.len(), part.start);
        self.out.push_str(with);
        self.pending = part.end;
    }

    /// Walks over a value, and replaces what is in it. Returns where it ends. `inside` are the shapes around it.
    fn value(&mut self, at: usize, scope: &mut Scope<'_>, place: Place, inside: &[String]) -> usize {
        match self.text.as_bytes().get(at) {
            Some(b'{') => self.object(at, scope, place, inside),
            Some(b'[') => {
                let mut at = skip_space(self.text, at + 1);
                while self.text.as_bytes().get(at).is_some_and(|byte| *byte != b']') {
                    at = self.value(at, scope, Place::Elsewhere, inside);
                    at = scan::skip_separator(self.text, at);
                }
                at + 1
            }
            _ => end_of(self.text, at),
        }
    }

    fn object(&mut self, start: usize, scope: &mut Scope<'_>, place: Place, inside: &[String]) -> usize {
        if let Some(formula) = scan::formula(self.text, start) {
            let value = self.formula(&formula, scope);
            let end = end_of(self.text, start);
            self.replace(start..end, &json(&value));
            return end;
        }
        let bytes = self.text.as_bytes();
        let mut at = skip_space(self.text, start + 1);
        while bytes.get(at).is_some_and(|byte| *byte == b'"') {
            let key_end = string_end(self.text, at);
            let key = &self.text[at + 1..key_end - 1];
            let value = skip_space(self.text, skip_space(self.text, key_end) + 1);
            at = match (place, key) {
                (Place::Job, "scene") => self.value(value, scope, Place::Scene, inside),
                (Place::Scene, "numbers") => end_of(self.text, value),
                (Place::Scene, "shapes") => {
                    let end = end_of(self.text, value);
                    if bytes.get(value) == Some(&b'{') {
                        // They are written once it is known which are used how.
                        self.flush(value);
                        self.shapes_at = Some((self.out.len(), value));
                        self.pending = end;
                    }
                    end
                }
                (_, "use") => self.used(value, scope, inside),
                (Place::Copies, "at") if scan::is_counted(self.text, value) => self.counted(value, scope, inside),
                (_, "copies") => self.value(value, scope, Place::Copies, inside),
                (Place::Copies, "child") => {
                    let at = scan::member(self.text, start, "at");
                    let is_counted = at.is_some_and(|at| scan::is_counted(self.text, at));
                    let was_copied = std::mem::replace(&mut scope.is_copied, is_counted);
                    let end = self.value(value, scope, Place::Elsewhere, inside);
                    scope.is_copied = was_copied;
                    end
                }
                _ => self.value(value, scope, Place::Elsewhere, inside),
            };
            at = scan::skip_separator(self.text, at);
        }
        at + 1
    }

    /// The value of the formula in a string.
    fn formula(&mut self, string: &Range<usize>, scope: &mut Scope<'_>) -> Arc<Expr> {
        let text = scan::string(self.text, string);
        let parsed = self.parsed.get(&string.start).cloned();
        let parsed = parsed.unwrap_or_else(|| {
            let parsed = crate::values::formula::parse(&text).map(Arc::new);
            let parsed = parsed.map_err(|error| {
                self.fault(scan::offset_in_string(self.text, string, error.at), error.message);
            });
            self.parsed.insert(string.start, parsed.clone());
            parsed
        });
        let Ok(syntax) = parsed else { return stand_in() };
        let resolved = crate::values::formula::resolve(&syntax, &mut scope.names(&mut self.numbers, &mut self.faults));
        resolved.unwrap_or_else(|error| {
            let at = scan::offset_in_string(self.text, string, error.at);
            // A formula of counted copies is told once, for the first copy for which it is wrong.
            let is_told = scope.copy().is_some() && self.faults.range((at, String::new())..).any(|told| told.0 == at);
            let copy = scope.copy().filter(|_| error.message.contains("no finite value"));
            let copy = copy.map(|copy| format!(" (for the copy i = {copy})")).unwrap_or_default();
            if !is_told {
                self.fault(at, error.message + &copy);
            }
            stand_in()
        })
    }

    /// Replaces the value of a `use` if it has numbers. Returns where it ends.
    fn used(&mut self, value: usize, scope: &mut Scope<'_>, inside: &[String]) -> usize {
        let end = end_of(self.text, value);
        if self.text.as_bytes().get(value) == Some(&b'"') {
            let name = scan::string(self.text, &(value..end));
            self.plain_use(&name);
            return end;
        }
        let (Some(shape), Some(with)) =
            (scan::member(self.text, value, "shape"), scan::member(self.text, value, "with"))
        else {
            return end;
        };
        if self.text.as_bytes().get(shape) != Some(&b'"') || self.text.as_bytes().get(with) != Some(&b'{') {
            return end;
        }
        let shape = scan::string(self.text, &(shape..string_end(self.text, shape)));
        let (mut numbers, mut keys) = (BTreeMap::new(), BTreeMap::new());
        for (key, given) in members(self.text, with) {
            let name = scan::string(self.text, &key);
            let number = match scan::formula_or_string(self.text, &given) {
                Some(formula) => Some(self.formula(&formula, scope)),
                None => names::number(&self.text[given.clone()]),
            };
            let number = number.unwrap_or_else(|| {
                let message = "must be a number, a formula as text, or a track";
                self.fault(given.start, message);
                stand_in()
            });
            keys.insert(name.clone(), key.start);
            numbers.insert(name, number);
        }
        if !self.shapes.contains_key(&shape) {
            self.replace(value..end, &quoted(&shape));
            return end;
        }
        if inside.len() == MAX_NODE_DEPTH {
            self.fault(value, format!("nests uses with numbers deeper than {MAX_NODE_DEPTH}: nest fewer"));
            self.replace(value..end, "null");
            return end;
        }
        if inside.contains(&shape) {
            let path: Vec<String> = inside.iter().chain([&shape]).map(|name| format!("\"{name}\"")).collect();
            let message =
                format!("makes \"{shape}\" a part of itself ({}): remove one of these uses", path.join(" → "));
            self.fault(value, message);
            self.replace(value..end, "null");
            return end;
        }
        let name = self.instance(&shape, numbers, keys, inside, value);
        self.replace(value..end, &quoted(&name));
        end
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
    fn write_shapes(&mut self, start: usize) {
        self.push_replaced(start, "{");
        let (mut separator, mut next) = ("", 0);
        let mut others = self.shapes.keys().cloned().collect::<Vec<_>>().into_iter();
        loop {
            while let Some(name) = self.to_write.get(next).cloned() {
                next += 1;
                self.push_replaced(start, separator);
                self.write_shape(&name);
                separator = ",";
            }
            // Shapes that are not used at all are checked, too.
            let Some(other) = others.next() else { break };
            if !self.used.contains(&other) {
                self.plain_use(&other);
            }
        }
        self.push_replaced(start, "}");
    }

    fn write_shape(&mut self, name: &str) {
        let Some(Instance { shape, with, keys, mut inside }) = self.instances.get(name).cloned() else { return };
        let Some((key, value)) = self.shapes.get(&shape).cloned() else { return };
        self.push_replaced(key.start, &format!("{}:", quoted(name)));
        self.pending = value.start;
        if !with.is_empty() {
            inside.push(shape.clone());
        }
        let mut scope = Scope::new(&with);
        scope.is_in_shape = true;
        self.value(value.start, &mut scope, Place::Elsewhere, &inside);
        self.flush(value.end);
        let asked = scope.asked;
        for (number, at) in keys.iter().filter(|(number, _)| !asked.contains(*number)) {
            let known: Vec<&str> = asked.iter().map(String::as_str).collect();
            let meant = nearest_name(number, &known).map(|meant| format!("; did you mean \"{meant}\"?"));
            let meant = meant.unwrap_or_default();
            self.fault(*at, format!("is in no formula of \"{shape}\": remove it, or use it there{meant}"));
        }
    }

    /// Writes placements that count copies, as a list. Returns where they end.
    fn counted(&mut self, start: usize, scope: &mut Scope<'_>, inside: &[String]) -> usize {
        let end = end_of(self.text, start);
        let Some(count_at) = scan::member(self.text, start, "count") else { return end };
        let count = match scan::formula(self.text, count_at) {
            Some(formula) => self.formula(&formula, scope).constant(),
            None => self.text[count_at..end_of(self.text, count_at)].parse().ok(),
        };
        let Some(whole) = count.filter(|count| count.fract() == 0.0 && (1.0..=MAX_NODES as f32).contains(count)) else {
            let written = count.map(|count| format!(", not {count}")).unwrap_or_default();
            self.fault(
                count_at,
                format!("must be a whole number of copies from 1 to {MAX_NODES}, the same in all frames{written}"),
            );
            self.replace(start..end, "[{}]");
            return end;
        };
        let count = whole as u32;
        self.flush(start);
        let own: Vec<_> = members(self.text, start).filter(|(key, _)| &self.text[key.clone()] != "\"count\"").collect();
        for index in 0..count {
            self.push_replaced(start, if index == 0 { "[{" } else { ",{" });
            for (place, (key, value)) in own.iter().enumerate() {
                if place > 0 {
                    self.push_replaced(key.start, ",");
                }
                self.pending = key.start;
                scope.counting(index, count, |scope| self.value(value.start, scope, Place::Elsewhere, inside));
                self.flush(value.end);
            }
            self.push_replaced(start, "}");
            if self.is_too_large {
                break;
            }
        }
        self.push_replaced(start, "]");
        self.pending = end;
        end
    }

    fn push_replaced(&mut self, from: usize, text: &str) {
        self.source.replaced(self.out.len(), from);
        self.out.push_str(text);
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
