//! Families of kinds: the macro that makes a family from its list, and examples of kinds for tests and docs.
//!
//! A family is an enum, with a variant for each kind, and a trait that each kind implements. `family!` makes both from
//! the list of kinds and the list of methods. The enum has the same methods, and each calls the kind's: the list is
//! the dispatch, and no file outside the family branches on its kinds. What one kind alone answers is a method of the enum
//! in the file of that kind.

pub use math::snake_case;

/// A kind of a family.
#[derive(Clone, Debug)]
pub struct Kind {
    /// Name of its type, as in the schema.
    pub type_name: &'static str,
    /// Its name in JSON.
    pub name: String,
    /// Its names in other tools and in common usage.
    pub aliases: &'static [&'static str],
    /// Its examples, as a user would write them after its name.
    values: fn() -> Vec<String>,
}

impl Kind {
    /// The kind of a variant.
    pub(crate) fn new(
        type_name: &'static str,
        variant: &str,
        aliases: &'static [&'static str],
        values: fn() -> Vec<String>,
    ) -> Self {
        Self { type_name, name: snake_case(variant), aliases, values }
    }

    /// Its examples, as objects whose member is its name. A kind without fields is its name alone.
    pub(crate) fn examples(&self) -> impl Iterator<Item = Example> {
        self.plain_examples().map(|Example { kind, name, index, json }| {
            let word = format!("\"{name}\"");
            let json = if json == word { json } else { format!("{{ {word}: {json} }}") };
            Example { kind, name, index, json }
        })
    }

    /// Its examples, without its name.
    pub(crate) fn plain_examples(&self) -> impl Iterator<Item = Example> {
        let values = (self.values)().into_iter().enumerate();
        values.map(|(index, json)| Example { kind: self.type_name, name: self.name.clone(), index, json })
    }
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

/// Makes a family: an enum from a list of kinds, and the trait of its kinds from a list of methods.
///
/// A kind is written `Variant(Struct)`, `Variant(Struct boxed)` if it is large, or `Variant` if it has no fields; the
/// struct then has the variant's name. A method is written as in a trait, with `= value` for its default. `&other` is a
/// parameter for another value of the same kind. The enum has each method, too, and calls the kind's.
macro_rules! family {
    (@enum
        {$($(#[doc = $about:literal])* $(#[cfg($cfg:meta)])? $Kind:ident $(($Struct:ident $($boxed:ident)?))?),* $(,)?}
        $Family:ident [$($attribute:tt)*]
    ) => {
        #[derive(
            Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema, $crate::seek::Seek,
        )]
        #[serde(rename_all = "snake_case")]
        $($attribute)*
        pub enum $Family {$(
            $(#[doc = $about])*
            $(#[cfg($cfg)])?
            $(#[doc = concat!("See [`", stringify!($Struct), "`].")])?
            $Kind $((family!(@payload $Struct $($boxed)?)))?
        ),*}
    };
    (@payload $Struct:ident) => { $Struct };
    (@payload $Struct:ident boxed) => { std::boxed::Box<$Struct> };
    // Its kinds, and which of them a value is.
    (@kinds
        {$($(#[doc = $about:literal])* $(#[cfg($cfg:meta)])? $Kind:ident $(($Struct:ident $($boxed:ident)?))?),* $(,)?}
        $Family:ident $Trait:ident
    ) => {
        impl $Family {
            /// Its kinds, in the order of the list.
            pub fn kinds() -> Vec<$crate::kinds::Kind> {
                [$(
                    $(#[cfg($cfg)])?
                    $crate::kinds::Kind::new(
                        family!(@type_name $Kind $($Struct)?),
                        stringify!($Kind),
                        <family!(@type $Kind $($Struct)?) as $Trait>::ALIASES,
                        <family!(@type $Kind $($Struct)?) as $Trait>::examples,
                    )
                ),*].into()
            }

            /// The examples of all kinds, as a user would write them.
            pub fn examples() -> Vec<$crate::kinds::Example> {
                Self::kinds().iter().flat_map($crate::kinds::Kind::examples).collect()
            }

            /// Name of the kind's type.
            pub fn type_name(&self) -> &'static str {
                match self {
                    $($(#[cfg($cfg)])? Self::$Kind { .. } => family!(@type_name $Kind $($Struct)?)),*
                }
            }

            /// Name of the kind in JSON.
            pub fn name(&self) -> &'static str {
                match self {
                    $($(#[cfg($cfg)])? Self::$Kind { .. } => {
                        static NAME: std::sync::LazyLock<String> =
                            std::sync::LazyLock::new(|| $crate::kinds::snake_case(stringify!($Kind)));
                        &NAME
                    }),*
                }
            }
        }
    };
    (@type $Kind:ident) => { $Kind };
    (@type $Kind:ident $Struct:ident) => { $Struct };
    (@type_name $Kind:ident) => { stringify!($Kind) };
    (@type_name $Kind:ident $Struct:ident) => { stringify!($Struct) };
    // A method of the trait, with its parameters and its default.
    (@method [$($signature:tt)*] [$($parameter:ident)*]) => { $($signature)*; };
    (@method [$($signature:tt)*] [$($parameter:ident)*] $default:expr) => {
        $($signature)* {
            let _ = ($(&$parameter,)*);
            $default
        }
    };
    // A method of the enum: calls the kind's.
    (@call $kinds:tt $Family:ident $Trait:ident [mut $($this:ident)*] $method:ident $arguments:tt) => {
        family!(@call $kinds $Family $Trait [$($this)*] $method $arguments)
    };
    (@call
        {$($(#[doc = $about:literal])* $(#[cfg($cfg:meta)])? $Kind:ident $(($Struct:ident $($boxed:ident)?))?),* $(,)?}
        $Family:ident $Trait:ident [$this:ident] $method:ident $arguments:tt
    ) => {
        match $this {$(
            $(#[cfg($cfg)])?
            $Family::$Kind $((family!(@bind $Struct kind)))? =>
                family!(@apply $Trait $method $arguments $Kind $($Struct kind)?)
        ),*}
    };
    (@call
        {$($(#[doc = $about:literal])* $(#[cfg($cfg:meta)])? $Kind:ident $(($Struct:ident $($boxed:ident)?))?),* $(,)?}
        $Family:ident $Trait:ident [$this:ident $other:ident] $method:ident $arguments:tt
    ) => {
        match ($this, $other) {
            $(
                $(#[cfg($cfg)])?
                ($Family::$Kind $((family!(@bind $Struct kind)))?, $Family::$Kind $((family!(@bind $Struct $other)))?) =>
                    family!(@apply $Trait $method $arguments $Kind $($Struct kind)?),
            )*
            _ => unreachable!("a value has the same kind in all frames"),
        }
    };
    (@bind $Struct:ident $kind:ident) => { $kind };
    (@apply $Trait:ident $method:ident ($($argument:ident)*) $Kind:ident) => { $Kind.$method($($argument),*) };
    (@apply $Trait:ident $method:ident ($($argument:ident)*) $Kind:ident $Struct:ident $kind:ident) => {
        <$Struct as $Trait>::$method($kind $(, $argument)*)
    };
    (
        $(#[$attribute:meta])*
        pub enum $Family:ident $kinds:tt

        $(#[$role:meta])*
        pub trait $Trait:ident {$(
            $(#[$doc:meta])*
            fn $method:ident $(<$($R:ident: $Bound:path),+>)? (
                &$($this:ident)+ $(, &$other:ident)? $(, $parameter:ident: $Parameter:ty)* $(,)?
            ) $(-> $Out:ty)? $(= $default:expr)?;
        )*}
    ) => {
        family!(@enum $kinds $Family [$(#[$attribute])*]);
        family!(@kinds $kinds $Family $Trait);

        $(#[$role])*
        pub trait $Trait {
            /// Names that other tools and common usage give it, to suggest its own.
            const ALIASES: &'static [&'static str] = &[];

            /// A small valid value, as a user would write it, for its picture in the docs and for the contract tests.
            const EXAMPLE: &'static str;

            /// Further values that exercise other branches of the formula, rendered and tested like the first.
            const MORE_EXAMPLES: &'static [&'static str] = &[];

            /// All values to be rendered and tested.
            fn examples() -> Vec<String> {
                std::iter::once(&Self::EXAMPLE).chain(Self::MORE_EXAMPLES).map(ToString::to_string).collect()
            }
            $(
                family! {
                    @method
                    [
                        $(#[$doc])*
                        fn $method $(<$($R: $Bound),+>)? (
                            &$($this)+ $(, $other: &Self)? $(, $parameter: $Parameter)*
                        ) $(-> $Out)?
                    ]
                    [$($other)? $($parameter)*]
                    $($default)?
                }
            )*
        }

        impl $Family {$(
            $(#[$doc])*
            pub fn $method $(<$($R: $Bound),+>)? (
                &$($this)+ $(, $other: &Self)? $(, $parameter: $Parameter)*
            ) $(-> $Out)? {
                family!(@call $kinds $Family $Trait [$($this)+ $($other)?] $method ($($other)? $($parameter)*))
            }
        )*}
    };
}

pub(crate) use family;

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
