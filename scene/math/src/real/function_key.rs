//! Keys of the functions that formulas share.

use std::panic::Location;

/// Key of a function that a formula calls in several places.
///
/// It is the function's name in generated code, and the line that made the key. So two functions never share an entry,
/// and a tape with one name for two of them is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FunctionKey {
    name: &'static str,
    made_at: &'static Location<'static>,
}

impl FunctionKey {
    /// The function with this name, which no other line may use.
    #[track_caller]
    pub const fn new(name: &'static str) -> Self {
        Self { name, made_at: Location::caller() }
    }

    /// Its name in generated code.
    pub const fn name(self) -> &'static str {
        self.name
    }
}
