//! Rows of results.

use std::fmt::Display;

use sqlx::postgres::{PgRow, PgValueRef, Postgres};
use sqlx::sqlite::{SqliteRow, SqliteValueRef};
use sqlx::{ColumnIndex, Database, Decode, Row as _, Sqlite, TypeInfo, ValueRef};

use super::DatabaseError;
use super::value::{Cell, Column};

/// A row of a result.
#[derive(Debug)]
pub(crate) enum Row {
    /// Of a file.
    Sqlite(SqliteRow),
    /// Of a PostgreSQL database.
    Postgres(PgRow),
}

impl From<SqliteRow> for Row {
    fn from(row: SqliteRow) -> Self {
        Self::Sqlite(row)
    }
}

impl From<PgRow> for Row {
    fn from(row: PgRow) -> Self {
        Self::Postgres(row)
    }
}

impl Row {
    /// Reads a column, by its name or its position.
    pub(crate) fn get<T: Column>(&self, column: impl Index) -> Result<T, DatabaseError> {
        let cell = match self {
            Self::Sqlite(row) => read_sqlite(row.try_get_raw(column)?)?,
            Self::Postgres(row) => read_postgres(row.try_get_raw(column)?)?,
        };
        let kind = cell.kind();
        T::from_cell(cell).ok_or_else(|| {
            let source = format!("a value of kind {kind} cannot be read as {}", std::any::type_name::<T>()).into();
            sqlx::Error::ColumnDecode { index: column.to_string(), source }.into()
        })
    }
}

/// Name or position of a column.
pub(crate) trait Index: ColumnIndex<SqliteRow> + ColumnIndex<PgRow> + Display + Copy {}

impl<I: ColumnIndex<SqliteRow> + ColumnIndex<PgRow> + Display + Copy> Index for I {}

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

fn read_sqlite(value: SqliteValueRef<'_>) -> Result<Cell, DatabaseError> {
    let kind = value.type_info().name().to_owned();
    match kind.as_str() {
        _ if value.is_null() => Ok(Cell::Null),
        "INTEGER" | "BOOLEAN" => decode::<i64, Sqlite>(value).map(Cell::Integer),
        "REAL" => decode::<f64, Sqlite>(value).map(Cell::Real),
        "TEXT" => decode::<String, Sqlite>(value).map(Cell::Text),
        "BLOB" => decode::<Vec<u8>, Sqlite>(value).map(Cell::Bytes),
        other => Err(unknown_kind(other)),
    }
}

fn read_postgres(value: PgValueRef<'_>) -> Result<Cell, DatabaseError> {
    let kind = value.type_info().name().to_owned();
    match kind.as_str() {
        _ if value.is_null() => Ok(Cell::Null),
        "INT8" => decode::<i64, Postgres>(value).map(Cell::Integer),
        "INT4" => decode::<i32, Postgres>(value).map(|value| Cell::Integer(value.into())),
        "BOOL" => decode::<bool, Postgres>(value).map(|value| Cell::Integer(value.into())),
        "FLOAT8" => decode::<f64, Postgres>(value).map(Cell::Real),
        "TEXT" => decode::<String, Postgres>(value).map(Cell::Text),
        "BYTEA" => decode::<Vec<u8>, Postgres>(value).map(Cell::Bytes),
        other => Err(unknown_kind(other)),
    }
}

fn decode<'r, T: Decode<'r, E>, E: Database>(value: E::ValueRef<'r>) -> Result<T, DatabaseError> {
    T::decode(value).map_err(|source| sqlx::Error::Decode(source).into())
}

fn unknown_kind(kind: &str) -> DatabaseError {
    sqlx::Error::Decode(format!("the engine gave a value of kind {kind}").into()).into()
}
