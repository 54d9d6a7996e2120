//! Rows of results.

use std::fmt::Display;

use sqlx::sqlite::{SqliteRow, SqliteValueRef};
use sqlx::{ColumnIndex, Decode, Row as _, Sqlite, TypeInfo, ValueRef};

use super::DatabaseError;
use super::value::{Cell, Column};

/// A row of a result.
#[derive(Debug)]
pub(crate) struct Row(SqliteRow);

impl From<SqliteRow> for Row {
    fn from(row: SqliteRow) -> Self {
        Self(row)
    }
}

impl Row {
    /// Reads a column, by its name or its position.
    pub(crate) fn get<T: Column>(&self, column: impl Index) -> Result<T, DatabaseError> {
        let cell = read_cell(self.0.try_get_raw(column)?)?;
        let kind = cell.kind();
        T::from_cell(cell).ok_or_else(|| {
            let source = format!("a value of kind {kind} cannot be read as {}", std::any::type_name::<T>()).into();
            sqlx::Error::ColumnDecode { index: column.to_string(), source }.into()
        })
    }
}

/// Name or position of a column.
pub(crate) trait Index: ColumnIndex<SqliteRow> + Display + Copy {}

impl<I: ColumnIndex<SqliteRow> + Display + Copy> Index for I {}

impl Cell {
    fn kind(&self) -> &'static str {
        match self {
            Self::Null => "null",
            Self::Integer(_) => "integer",
            Self::Real(_) => "real",
            Self::Text(_) => "text",
            Self::Bytes(_) => "bytes",
        }
    }
}

fn read_cell(value: SqliteValueRef<'_>) -> Result<Cell, DatabaseError> {
    let kind = value.type_info().name().to_owned();
    match kind.as_str() {
        _ if value.is_null() => Ok(Cell::Null),
        "INTEGER" | "BOOLEAN" => decode(value).map(Cell::Integer),
        "REAL" => decode(value).map(Cell::Real),
        "TEXT" => decode(value).map(Cell::Text),
        "BLOB" => decode(value).map(Cell::Bytes),
        other => Err(unknown_kind(other)),
    }
}

fn decode<'r, T: Decode<'r, Sqlite>>(value: SqliteValueRef<'r>) -> Result<T, DatabaseError> {
    T::decode(value).map_err(|source| sqlx::Error::Decode(source).into())
}

fn unknown_kind(kind: &str) -> DatabaseError {
    sqlx::Error::Decode(format!("the engine gave a value of kind {kind}").into()).into()
}
