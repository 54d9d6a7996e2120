//! Rows of any engine.

use std::fmt::Display;

use sqlx::postgres::PgRow;
use sqlx::sqlite::SqliteRow;
use sqlx::{ColumnIndex, Database, Decode, Postgres, Row as _, Sqlite, TypeInfo, ValueRef};

use super::DatabaseError;
use super::value::{Cell, Column};

/// A row of a result.
#[derive(Debug)]
pub(crate) enum Row {
    /// Of SQLite.
    Sqlite(SqliteRow),
    /// Of PostgreSQL.
    Postgres(PgRow),
}

impl Row {
    /// Reads a column, by its name or its position.
    pub(crate) fn get<T: Column>(&self, column: impl Index) -> Result<T, DatabaseError> {
        let cell = match self {
            Self::Sqlite(row) => sqlite_cell(row.try_get_raw(column)?)?,
            Self::Postgres(row) => postgres_cell(row.try_get_raw(column)?)?,
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

/// Reads a value of SQLite.
fn sqlite_cell(value: sqlx::sqlite::SqliteValueRef<'_>) -> Result<Cell, DatabaseError> {
    let kind = value.type_info().name().to_owned();
    match kind.as_str() {
        _ if value.is_null() => Ok(Cell::Null),
        "INTEGER" | "BOOLEAN" => decode::<Sqlite, _>(value).map(Cell::Integer),
        "REAL" => decode::<Sqlite, _>(value).map(Cell::Real),
        "TEXT" => decode::<Sqlite, _>(value).map(Cell::Text),
        "BLOB" => decode::<Sqlite, _>(value).map(Cell::Bytes),
        other => Err(unknown_kind(other)),
    }
}

/// Reads a value of PostgreSQL.
fn postgres_cell(value: sqlx::postgres::PgValueRef<'_>) -> Result<Cell, DatabaseError> {
    let kind = value.type_info().name().to_owned();
    match kind.as_str() {
        _ if value.is_null() => Ok(Cell::Null),
        "INT8" => decode::<Postgres, _>(value).map(Cell::Integer),
        "INT4" => decode::<Postgres, i32>(value).map(|number| Cell::Integer(number.into())),
        "BOOL" => decode::<Postgres, bool>(value).map(|truth| Cell::Integer(truth.into())),
        "FLOAT8" => decode::<Postgres, _>(value).map(Cell::Real),
        "TEXT" | "VARCHAR" | "NAME" => decode::<Postgres, _>(value).map(Cell::Text),
        "BYTEA" => decode::<Postgres, _>(value).map(Cell::Bytes),
        other => Err(unknown_kind(other)),
    }
}

fn decode<'r, D: Database, T: Decode<'r, D>>(value: D::ValueRef<'r>) -> Result<T, DatabaseError> {
    T::decode(value).map_err(|source| sqlx::Error::Decode(source).into())
}

fn unknown_kind(kind: &str) -> DatabaseError {
    sqlx::Error::Decode(format!("the engine gave a value of kind {kind}").into()).into()
}
