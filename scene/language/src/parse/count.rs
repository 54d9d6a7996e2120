//! Counts what a job becomes when its formulas, uses of shapes and counted copies are replaced, without making it.

use std::collections::BTreeMap;

use super::expand::{self, Numbers};
use crate::json::{Kind, Tree, Value};
use crate::limits::{MAX_NODE_DEPTH, MAX_NODES};

/// The most that a job becomes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Expansion {
    /// Values of the job without formulas, those in lists and objects included; a formula is one.
    pub values: u64,
    /// Evaluations of formulas; each makes a number, or if it depends on time, the list of its steps.
    pub formulas: u64,
    /// Placements that counted copies make.
    pub copies: u64,
    /// Bytes of the job as text without formulas, spaces and comments.
    pub bytes: u64,
}

/// Maximum number of bytes of a number in the name of a use with numbers.
const MAX_NUMBER_BYTES: usize = 48;

/// Counts what a tree becomes. A count of copies that is not known here, because it depends on other copies or on a
/// shape's own numbers, is taken as the largest.
pub(super) fn count(tree: &Tree<'_>) -> Expansion {
    let shapes = tree.root().get("scene").and_then(|scene| scene.get("shapes"));
    let mut counter = Counter {
        numbers: Numbers::new(tree.root()),
        shapes,
        total: Expansion::default(),
        is_in_shape: false,
        used: BTreeMap::new(),
    };
    counter.value(tree.root(), 1);
    let shapes = shapes.into_iter().flat_map(Value::members).enumerate().map(|(place, (name, shape))| {
        counter.key(place, name, 1);
        (name.string(), shape)
    });
    let shapes: BTreeMap<_, _> = shapes.collect();
    counter.is_in_shape = true;
    // Each shape is written once, and once more for each use with numbers.
    let mut used: BTreeMap<String, u64> = shapes.keys().map(|name| (name.to_string(), 1)).collect();
    for (name, times) in std::mem::take(&mut counter.used) {
        *used.entry(name).or_default() += times;
    }
    // Uses in shapes that are written more often make more of other shapes.
    for _ in 0..=MAX_NODE_DEPTH {
        for (name, times) in std::mem::take(&mut used) {
            if let Some(shape) = shapes.get(name.as_str()) {
                counter.value(*shape, times.min(expand::MAX_INSTANCES as u64 + 1));
            }
        }
        used = std::mem::take(&mut counter.used);
    }
    counter.total
}

struct Counter<'t> {
    numbers: Numbers<'t>,
    /// The named shapes, which are counted apart.
    shapes: Option<Value<'t>>,
    total: Expansion,
    /// Whether this is inside of a named shape, whose numbers are not known.
    is_in_shape: bool,
    /// How often each shape is written for uses with numbers.
    used: BTreeMap<String, u64>,
}

impl<'t> Counter<'t> {
    /// Counts a value that is made some times.
    fn value(&mut self, value: Value<'t>, times: u64) {
        if self.shapes.is_some_and(|shapes| shapes.index() == value.index()) {
            return self.add(times, "{}".len());
        }
        if expand::formula(value).is_some() {
            self.total.formulas = self.total.formulas.saturating_add(times);
            return self.add(times, 0);
        }
        let brackets = if value.is_container() { "{}".len() } else { value.text().len() };
        self.add(times, brackets);
        for (place, entry) in value.entries().enumerate() {
            self.add_bytes(times, usize::from(place > 0));
            self.value(entry, times);
        }
        for (place, (key, inside)) in value.members().enumerate() {
            self.key(place, key, times);
            match key.raw() {
                "use" if inside.kind() == Kind::Object => self.used(inside, times),
                "copies" => self.copies(inside, times),
                _ => self.value(inside, times),
            }
        }
    }

    fn add(&mut self, times: u64, bytes: usize) {
        self.total.values = self.total.values.saturating_add(times);
        self.add_bytes(times, bytes);
    }

    fn add_bytes(&mut self, times: u64, bytes: usize) {
        self.total.bytes = self.total.bytes.saturating_add(times.saturating_mul(bytes as u64));
    }

    /// Counts a key with its colon, and the comma before it.
    fn key(&mut self, place: usize, key: Value<'t>, times: u64) {
        self.add_bytes(times, usize::from(place > 0) + key.text().len() + 1);
    }

    fn used(&mut self, value: Value<'t>, times: u64) {
        let (Some(shape), Some(with)) = (value.get("shape"), value.get("with")) else {
            return self.value(value, times);
        };
        // It becomes the name of a shape, which is the key of that shape, too.
        let numbers = with.members().map(|(key, _)| key.raw().len() + "=, ".len() + MAX_NUMBER_BYTES);
        let name_bytes = shape.text().len() + "()".len() + numbers.sum::<usize>();
        self.add(times, 2 * name_bytes + ":,".len());
        let formulas = with.members().filter(|(_, number)| expand::formula_or_string(*number).is_some()).count();
        self.total.formulas = self.total.formulas.saturating_add(times.saturating_mul(formulas as u64));
        let all = self.used.entry(shape.string().into_owned()).or_default();
        *all = all.saturating_add(times);
    }

    fn copies(&mut self, value: Value<'t>, times: u64) {
        self.add(times, if value.is_container() { "{}".len() } else { value.text().len() });
        for (place, (key, inside)) in value.members().enumerate() {
            self.key(place, key, times);
            match inside.get("count") {
                Some(count) if key.raw() == "at" && expand::is_counted(inside) => {
                    let copies = times.saturating_mul(self.copy_count(count));
                    if expand::formula(count).is_some() {
                        self.total.formulas = self.total.formulas.saturating_add(times);
                    }
                    self.total.copies = self.total.copies.saturating_add(copies);
                    // The list, and in it an object for each copy.
                    self.add(times, "[]".len());
                    self.add(copies, "{},".len());
                    let own = inside.members().filter(|(key, _)| key.raw() != "count");
                    for (place, (key, own)) in own.enumerate() {
                        self.key(place, key, copies);
                        self.value(own, copies);
                    }
                }
                _ => self.value(inside, times),
            }
        }
    }

    /// Number of copies, or the largest allowed.
    fn copy_count(&mut self, count: Value<'t>) -> u64 {
        let known = match expand::formula(count) {
            Some(_) if self.is_in_shape => None,
            Some(formula) => self.numbers.of_scene(formula),
            None => count.text().parse().ok(),
        };
        // A wrong count becomes one copy.
        known.map_or(MAX_NODES as u64, |count: f32| (count.clamp(1.0, MAX_NODES as f32)) as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::super::expand::expand;
    use super::*;
    use crate::values::formula::MAX_FORMULA_STEPS;

    const VIEW: &str = r#""camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] }"#;

    /// Counted things, the number of values that are made, and their bytes.
    fn counted(text: &str) -> (Expansion, u64, u64) {
        let tree = Tree::read(text).unwrap_or_else(|error| panic!("{error:?}"));
        let made = expand(&tree).tree;
        (count(&tree), made.value_count() as u64, bytes(made.root()))
    }

    /// Bytes of a value as text without spaces.
    fn bytes(value: Value<'_>) -> u64 {
        let entries = value.entries().map(|entry| bytes(entry) + 1);
        let members = value.members().map(|(key, inside)| key.text().len() as u64 + bytes(inside) + 2);
        match (value.is_container(), entries.chain(members).sum::<u64>()) {
            (true, inside) => inside.saturating_sub(1) + 2,
            (false, _) => value.text().len() as u64,
        }
    }

    fn scene(rest: &str) -> String {
        format!(r#"{{ "scene": {{ {VIEW}, {rest} }}, "image": {{ "width": 8, "height": 8 }} }}"#)
    }

    #[test]
    fn numbers_and_copies_are_counted_exactly() {
        for (rest, formulas, copies) in [
            (r#""objects": [{ "shape": { "sphere": { "radius": 1 } } }]"#, 0, 0),
            (
                r#""numbers": { "r": 2 }, "objects": [{ "shape": { "sphere": { "radius": { "expr": "r / 2" } } } }]"#,
                1,
                0,
            ),
            (
                r#""numbers": { "k": 30 }, "objects": [{ "shape": { "copies": { "child": { "sphere": { "radius": 1 } },
                "at": { "count": { "expr": "2 * k" }, "by": [{ "expr": "i" }, 0, { "expr": "n" }] } } } }]"#,
                121,
                60,
            ),
        ] {
            let (count, made, made_bytes) = counted(&scene(rest));
            assert_eq!((count.values, count.copies), (made, copies), "{rest}");
            assert_eq!(count.formulas, formulas, "{rest}");
            // A number has up to four digits here, and one comma is counted too many for each counted list.
            let bytes = count.bytes..=count.bytes + 4 * formulas;
            assert!(bytes.contains(&(made_bytes + u64::from(copies > 0))), "{made_bytes} of {count:?}");
        }
    }

    #[test]
    fn uses_with_numbers_are_bounded() {
        let leg = r#""leg": { "union": { "of": [{ "sphere": { "radius": { "expr": "r" } } }, { "use": "foot" }] } },
            "foot": { "sphere": { "radius": 1 } },
            "pair": { "union": { "of": [{ "use": { "shape": "leg", "with": { "r": "2 * s" } } }, { "use": "leg" }] } }"#;
        let uses: Vec<String> =
            (1..9).map(|s| format!(r#"{{ "use": {{ "shape": "pair", "with": {{ "s": {s} }} }} }}"#)).collect();
        let text = scene(&format!(
            r#""numbers": {{ "r": 1, "s": 1 }}, "shapes": {{ {leg} }}, "objects": [{{ "shape": {{ "union": {{ "of": [{}] }} }} }}]"#,
            uses.join(", ")
        ));
        let (count, made, made_bytes) = counted(&text);
        assert!((made..2 * made).contains(&count.values), "{made} values are counted as {count:?}");
        assert!((made_bytes..4 * made_bytes).contains(&count.bytes), "{made_bytes} bytes are counted as {count:?}");
    }

    #[test]
    fn what_would_be_too_large_is_counted_without_being_made() {
        let mut shape = r#"{ "sphere": { "radius": 1 } }"#.to_owned();
        for _ in 0..20 {
            shape = format!(
                r#"{{ "copies": {{ "child": {shape}, "at": {{ "count": 1000000, "by": [{{ "expr": "i" }}, 0, 0] }} }} }}"#
            );
        }
        let text = scene(&format!(r#""objects": [{{ "shape": {shape} }}]"#));
        let tree = Tree::read(&text).unwrap_or_else(|error| panic!("{error:?}"));
        let count = count(&tree);
        assert_eq!(count.copies, 20_000_000);
        assert!(count.bytes > 20_000_000 * r#"{"by":[,0,0]},"#.len() as u64, "{count:?}");
    }

    #[test]
    fn shipped_scenes_become_no_more_than_is_counted() {
        let mut files = 0;
        for entry in std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes")).expect("scenes") {
            let path = entry.expect("an entry").path();
            if path.extension().is_none_or(|extension| extension != "json") {
                continue;
            }
            let (count, made, made_bytes) = counted(&std::fs::read_to_string(&path).expect("a scene"));
            // A list of steps has up to three values for each.
            let most = count.values + count.formulas * 3 * u64::from(MAX_FORMULA_STEPS);
            assert!(made <= most, "{}: {made} of {count:?}", path.display());
            let is_exact = (made, made_bytes) == (count.values, count.bytes);
            assert!(count.formulas > 0 || is_exact, "{}: {made}, {made_bytes} of {count:?}", path.display());
            files += 1;
        }
        assert!(files > 20, "{files} scenes");
    }
}
