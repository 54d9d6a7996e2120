//! Statements: one text for every engine, with its values.

use std::marker::PhantomData;

#[cfg(test)]
use sqlx::AssertSqlSafe;
use sqlx::postgres::Postgres;
use sqlx::query::Query;
use sqlx::sqlite::Sqlite;
use sqlx::{SqlSafeStr, SqlStr};

use super::DatabaseError;
use super::connection::Target;
use super::dialect::{self, Dialect};
use super::row::Row;
use super::value::{Column, Value};

/// Text of a statement.
#[derive(Clone, Debug)]
enum Text {
    /// Written in the program.
    Written(&'static str),
    /// Made by a test, of parts that are written in it.
    #[cfg(test)]
    Made(String),
}

/// A statement with its values, in the language of `dialect`.
#[derive(Clone, Debug)]
pub(crate) struct Statement {
    text: Text,
    values: Vec<Value>,
}

/// A statement whose rows have one column.
#[derive(Clone, Debug)]
pub(crate) struct ScalarStatement<T> {
    statement: Statement,
    column: PhantomData<fn() -> T>,
}

/// What a statement has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Changed {
    rows: u64,
}

impl Changed {
    /// Number of changed rows.
    pub(crate) fn rows_affected(self) -> u64 {
        self.rows
    }
}

/// A statement that is written in the program.
pub(crate) fn query(text: &'static str) -> Statement {
    Statement { text: Text::Written(text), values: Vec::new() }
}

/// A statement that a test makes of parts.
#[cfg(test)]
pub(crate) fn made_query(text: String) -> Statement {
    Statement { text: Text::Made(text), values: Vec::new() }
}

/// A statement whose rows have one column.
pub(crate) fn query_scalar<T: Column>(text: &'static str) -> ScalarStatement<T> {
    query(text).scalar()
}

impl Statement {
    /// Binds the next parameter.
    pub(crate) fn bind(mut self, value: impl Into<Value>) -> Self {
        self.values.push(value.into());
        self
    }

    /// The same statement, whose rows have one column.
    pub(crate) fn scalar<T: Column>(self) -> ScalarStatement<T> {
        ScalarStatement { statement: self, column: PhantomData }
    }

    /// Runs it, and returns how many rows it changed.
    pub(crate) async fn execute(self, on: impl Into<Target<'_>>) -> Result<Changed, DatabaseError> {
        let rows = match on.into() {
            Target::Sqlite(connection) => self.sqlite().execute(connection).await?.rows_affected(),
            Target::SqliteReaders(pool) => self.sqlite().execute(pool).await?.rows_affected(),
            Target::Postgres(connection) => self.postgres().execute(connection).await?.rows_affected(),
            Target::PostgresReaders(pool) => self.postgres().execute(pool).await?.rows_affected(),
        };
        Ok(Changed { rows })
    }

    /// Its rows.
    pub(crate) async fn fetch_all(self, on: impl Into<Target<'_>>) -> Result<Vec<Row>, DatabaseError> {
        Ok(match on.into() {
            Target::Sqlite(connection) => sqlite_rows(self.sqlite().fetch_all(connection).await?),
            Target::SqliteReaders(pool) => sqlite_rows(self.sqlite().fetch_all(pool).await?),
            Target::Postgres(connection) => postgres_rows(self.postgres().fetch_all(connection).await?),
            Target::PostgresReaders(pool) => postgres_rows(self.postgres().fetch_all(pool).await?),
        })
    }

    /// Its row, if there is one.
    pub(crate) async fn fetch_optional(self, on: impl Into<Target<'_>>) -> Result<Option<Row>, DatabaseError> {
        Ok(match on.into() {
            Target::Sqlite(connection) => self.sqlite().fetch_optional(connection).await?.map(Row::Sqlite),
            Target::SqliteReaders(pool) => self.sqlite().fetch_optional(pool).await?.map(Row::Sqlite),
            Target::Postgres(connection) => self.postgres().fetch_optional(connection).await?.map(Row::Postgres),
            Target::PostgresReaders(pool) => self.postgres().fetch_optional(pool).await?.map(Row::Postgres),
        })
    }

    /// Its row.
    pub(crate) async fn fetch_one(self, on: impl Into<Target<'_>>) -> Result<Row, DatabaseError> {
        self.fetch_optional(on).await?.ok_or_else(|| sqlx::Error::RowNotFound.into())
    }

    fn sqlite(self) -> Query<'static, Sqlite, <Sqlite as sqlx::Database>::Arguments> {
        let query = sqlx::query(self.text.into_dialect(Dialect::Sqlite));
        self.values.into_iter().fold(query, |query, value| match value {
            Value::Integer(value) => query.bind(value),
            Value::Real(value) => query.bind(value),
            Value::Text(value) => query.bind(value),
            Value::Bytes(value) => query.bind(value),
        })
    }

    fn postgres(self) -> Query<'static, Postgres, <Postgres as sqlx::Database>::Arguments> {
        let query = sqlx::query(self.text.into_dialect(Dialect::Postgres));
        self.values.into_iter().fold(query, |query, value| match value {
            Value::Integer(value) => query.bind(value),
            Value::Real(value) => query.bind(value),
            Value::Text(value) => query.bind(value),
            Value::Bytes(value) => query.bind(value),
        })
    }
}

impl<T: Column> ScalarStatement<T> {
    /// Binds the next parameter.
    pub(crate) fn bind(self, value: impl Into<Value>) -> Self {
        Self { statement: self.statement.bind(value), column: PhantomData }
    }

    /// The column in every row.
    pub(crate) async fn fetch_all(self, on: impl Into<Target<'_>>) -> Result<Vec<T>, DatabaseError> {
        self.statement.fetch_all(on).await?.iter().map(|row| row.get(0)).collect()
    }

    /// The column of the row, if there is one.
    pub(crate) async fn fetch_optional(self, on: impl Into<Target<'_>>) -> Result<Option<T>, DatabaseError> {
        self.statement.fetch_optional(on).await?.map(|row| row.get(0)).transpose()
    }

    /// The column of the row.
    pub(crate) async fn fetch_one(self, on: impl Into<Target<'_>>) -> Result<T, DatabaseError> {
        self.statement.fetch_one(on).await?.get(0)
    }
}

impl Text {
    fn into_dialect(self, dialect: Dialect) -> SqlStr {
        match self {
            Self::Written(text) => dialect::written(text, dialect).into_sql_str(),
            #[cfg(test)]
            Self::Made(text) => AssertSqlSafe(dialect::translate(&text, dialect)).into_sql_str(),
        }
    }
}

fn sqlite_rows(rows: Vec<sqlx::sqlite::SqliteRow>) -> Vec<Row> {
    rows.into_iter().map(Row::Sqlite).collect()
}

fn postgres_rows(rows: Vec<sqlx::postgres::PgRow>) -> Vec<Row> {
    rows.into_iter().map(Row::Postgres).collect()
}
