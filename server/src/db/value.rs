//! Values that statements take and that rows give, the same for every engine.
//!
//! There are four kinds, which every engine stores without loss. Truth is the integers 0 and 1.

/// Value bound to a parameter; `None` is null.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    /// 64-bit integer.
    Integer(Option<i64>),
    /// 64-bit float.
    Real(Option<f64>),
    /// Text.
    Text(Option<String>),
    /// Bytes.
    Bytes(Option<Vec<u8>>),
}

/// Implements the conversions of a type, and of an optional one.
macro_rules! values {
    ($($kind:ident: $($from:ty => $convert:expr),+;)+) => { $($(
        impl From<$from> for Value {
            fn from(value: $from) -> Self {
                Self::$kind(Some($convert(value)))
            }
        }

        impl From<Option<$from>> for Value {
            fn from(value: Option<$from>) -> Self {
                Self::$kind(value.map($convert))
            }
        }
    )+)+ };
}

values! {
    Integer: i64 => i64::from, i32 => i64::from, u32 => i64::from, u16 => i64::from, bool => i64::from;
    Real: f64 => f64::from;
    Text: &str => str::to_owned, String => String::from, &String => String::clone;
    Bytes: Vec<u8> => Vec::from, &[u8] => <[u8]>::to_vec;
}

impl From<&Option<String>> for Value {
    fn from(value: &Option<String>) -> Self {
        Self::Text(value.clone())
    }
}

/// Value of a column in a row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Cell {
    /// Null.
    Null,
    /// Integer, or truth.
    Integer(i64),
    /// Float.
    Real(f64),
    /// Text.
    Text(String),
    /// Bytes.
    Bytes(Vec<u8>),
}

/// Type that a column is read as.
pub(crate) trait Column: Sized {
    /// Reads a cell; `None` if it has another kind, or a number out of range.
    fn from_cell(cell: Cell) -> Option<Self>;
}

/// Implements [`Column`] for integers.
macro_rules! integers {
    ($($number:ty),+) => { $(
        impl Column for $number {
            fn from_cell(cell: Cell) -> Option<Self> {
                match cell {
                    Cell::Integer(value) => value.try_into().ok(),
                    Cell::Null | Cell::Real(_) | Cell::Text(_) | Cell::Bytes(_) => None,
                }
            }
        }
    )+ };
}

integers!(i64, i32, u64, u32, u16);

impl Column for Cell {
    fn from_cell(cell: Cell) -> Option<Self> {
        Some(cell)
    }
}

impl Column for bool {
    fn from_cell(cell: Cell) -> Option<Self> {
        i64::from_cell(cell).map(|value| value != 0)
    }
}

impl Column for f64 {
    fn from_cell(cell: Cell) -> Option<Self> {
        match cell {
            Cell::Real(value) => Some(value),
            Cell::Integer(value) => Some(value as Self),
            Cell::Null | Cell::Text(_) | Cell::Bytes(_) => None,
        }
    }
}

impl Column for String {
    fn from_cell(cell: Cell) -> Option<Self> {
        match cell {
            Cell::Text(value) => Some(value),
            Cell::Null | Cell::Integer(_) | Cell::Real(_) | Cell::Bytes(_) => None,
        }
    }
}

impl Column for Vec<u8> {
    fn from_cell(cell: Cell) -> Option<Self> {
        match cell {
            Cell::Bytes(value) => Some(value),
            Cell::Null | Cell::Integer(_) | Cell::Real(_) | Cell::Text(_) => None,
        }
    }
}

impl<T: Column> Column for Option<T> {
    fn from_cell(cell: Cell) -> Option<Self> {
        if cell == Cell::Null { Some(None) } else { T::from_cell(cell).map(Some) }
    }
}
