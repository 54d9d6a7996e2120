//! Examples of the kinds of every family, for tests and docs.
//!
//! A family is a list of kinds in the file that names it (`nodes.rs`, `materials.rs`, `lights.rs` and so on). The list
//! is the dispatch: no file outside the family branches on its kinds.

/// Kind with examples.
pub trait HasExamples {
    /// A small valid value, as a user would write it, for the picture in the docs and for the contract tests.
    const EXAMPLE: &'static str;

    /// Further values that exercise other branches of the formula, rendered and tested like the first.
    const MORE_EXAMPLES: &'static [&'static str] = &[];
}

/// A value of a kind, to render and to test with.
#[derive(Clone, Debug)]
pub struct Example {
    /// Name of its type, as in the schema.
    pub kind: &'static str,
    /// Its name in JSON.
    pub name: String,
    /// Index among the examples of its type, from 0.
    pub index: usize,
    /// Its JSON.
    pub json: String,
}

impl Example {
    /// The examples of one type; `json` writes one under its name.
    fn each<E: HasExamples>(kind: &'static str, name: &str, json: impl Fn(&str) -> String) -> Vec<Self> {
        let values = std::iter::once(&E::EXAMPLE).chain(E::MORE_EXAMPLES).enumerate();
        values.map(|(number, value)| Self { kind, name: name.to_owned(), index: number, json: json(value) }).collect()
    }

    /// The examples of one type, each an object whose member is the name of the `variant`.
    pub(crate) fn keyed<E: HasExamples>(kind: &'static str, variant: &str) -> Vec<Self> {
        let name = snake_case(variant);
        Self::each::<E>(kind, &name, |value| format!("{{ \"{name}\": {value} }}"))
    }

    /// The examples of one type that is in no family, under its own name.
    pub fn plain<E: HasExamples>(kind: &'static str) -> Vec<Self> {
        Self::each::<E>(kind, &snake_case(kind), str::to_owned)
    }

    /// The only example of a kind without fields: its name.
    pub fn unit(kind: &'static str) -> Self {
        let name = snake_case(kind);
        Self { kind, json: format!("\"{name}\""), name, index: 0 }
    }
}

/// Relation of a node's value to the Euclidean distance to its surface, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Exactness {
    /// The value is the distance.
    Exact,
    /// The value divided by its Lipschitz factor is never more than the distance.
    Bound,
    /// An estimate, which no Lipschitz factor bounds everywhere; a step of value/lipschitz still passes no surface.
    Estimate,
}

impl Exactness {
    /// This exactness, but at most a bound: for a formula around it that gives a bound.
    pub(crate) fn capped_at_bound(self) -> Self {
        match self {
            Self::Exact | Self::Bound => Self::Bound,
            Self::Estimate => Self::Estimate,
        }
    }
}

/// Error in the numbers of a node, a light or a background taken together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeError {
    /// JSON pointer within it: a member name, or a path of names and indices such as `points/2`.
    pub pointer: String,
    /// Message with the fix, continuing a sentence after the pointer.
    pub message: String,
}

impl NodeError {
    /// Error at a pointer within the node.
    pub fn new(place: impl Into<String>, message: impl Into<String>) -> Self {
        Self { pointer: place.into(), message: message.into() }
    }

    /// The same error, with its pointer prefixed by the member of the parent.
    pub fn inside(self, key: &str) -> Self {
        let separator = if self.pointer.is_empty() { "" } else { "/" };
        Self { pointer: format!("{key}{separator}{}", self.pointer), message: self.message }
    }
}

/// Name in JSON: `InfiniteCylinder` becomes `infinite_cylinder`.
pub fn snake_case(name: &str) -> String {
    let mut snake = String::new();
    for (index, letter) in name.char_indices() {
        if letter.is_ascii_uppercase() && index > 0 {
            snake.push('_');
        }
        snake.push(letter.to_ascii_lowercase());
    }
    snake
}
