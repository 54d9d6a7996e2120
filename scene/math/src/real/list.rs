//! Lists: the order in which the values of many functions are joined, as data.
//!
//! A list is a sequence of operations in a table, two words each. An operation takes the value of a leaf, or the last
//! value that waits, and joins it with the value that waits before it. Leaves of one function differ in their *rows*:
//! the numbers of the scene that the function asks for are the words of the table from the row's first on.
//!
//! | Word | Bits 0 to 24 | Bits 25 to 30 | Bit 31 |
//! |---|---|---|---|
//! | 1 | row of the leaf | its function, or [`NO_LEAF`] | whether the operation is the list's last |
//! | 2 | row of the join | its function plus 1; 0 for none: the value waits | whether the join takes one value only |

use super::{Bundle, Real, Table, Vec3};

/// Bits of a word that are the index of a row.
pub const ROW_BITS: u32 = 25;
/// These bits.
pub const ROW_MASK: u32 = (1 << ROW_BITS) - 1;
/// Function of an operation that has no leaf.
pub const NO_LEAF: u32 = 63;
/// Bit of an operation's first word: the operation is the last.
pub const IS_LAST: u32 = 1 << 31;
/// Bit of an operation's second word: the join takes one value.
pub const IS_UNARY: u32 = 1 << 31;
/// Words of an operation.
pub const OPERATION_WORDS: u32 = 2;

/// Index of the function in an operation's word.
pub fn function_of(word: u32) -> u32 {
    (word >> ROW_BITS) & NO_LEAF
}

/// The functions of lists.
pub trait ListFunctions<R: Real> {
    /// Type of the values that are joined.
    type Value: Bundle<R>;
    /// Names of the leaves' functions.
    fn leaf_names(&self) -> &[&'static str];
    /// Names of the joins' functions.
    fn join_names(&self) -> &[&'static str];
    /// Maximum number of values that wait.
    fn depth(&self) -> usize;
    /// The value of a leaf at a point. Its row is `None` in a recorded formula.
    fn leaf(&self, function: usize, row: Option<u32>, p: Vec3<R>) -> Self::Value;
    /// The join of the value that waits and the new one, which is of the function with this row.
    fn join(&self, function: usize, row: Option<u32>, below: Self::Value, value: Self::Value) -> Self::Value;
}

/// The value of a list of known words.
pub(super) fn fold<R: Real, F: ListFunctions<R>>(table: &Table, first: u32, p: Vec3<R>, functions: &F) -> F::Value {
    let word = |index: u32| table.get(index);
    let mut waiting: Vec<F::Value> = Vec::with_capacity(functions.depth());
    let mut at = first;
    loop {
        let (leaf, join) = (word(at), word(at + 1));
        let value = match function_of(leaf) {
            NO_LEAF => waiting.pop().expect("a value waits"),
            function => functions.leaf(function as usize, Some(leaf & ROW_MASK), p),
        };
        let joined = match function_of(join) {
            0 => value,
            function => {
                let below = if join & IS_UNARY == 0 { waiting.pop().expect("a value waits") } else { value };
                functions.join(function as usize - 1, Some(join & ROW_MASK), below, value)
            }
        };
        waiting.push(joined);
        if leaf & IS_LAST != 0 {
            return waiting.pop().expect("a list has a value");
        }
        at += OPERATION_WORDS;
    }
}

/// A bit of a word, as a condition.
pub fn is_set<R: Real>(word: R::Bits, bit: u32) -> R::Mask {
    R::from_bits(((word >> bit) & 1) | 1.0_f32.to_bits()).above(1.0)
}
