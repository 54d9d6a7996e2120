//! Statements: one text for every engine, with its values.

use std::marker::PhantomData;

use sqlx::postgres::{PgArguments, Postgres};
use sqlx::query::Query;
use sqlx::sqlite::{Sqlite, SqliteArguments};
use sqlx::{AssertSqlSafe, SqlSafeStr, SqlStr};

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
    /// Made of parts that are written in the program, and of names in the catalog of a database.
    Made(String),
}

/// A statement with its values, in the language that `dialect` describes.
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

/// Number of rows that a statement has changed.
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

/// A statement made of parts that are written in the program, and of names in the catalog of a database.
pub(crate) fn made_query(text: String) -> Statement {
    Statement { text: Text::Made(text), values: Vec::new() }
}

/// A statement whose rows have one column.
pub(crate) fn query_scalar<T: Column>(text: &'static str) -> ScalarStatement<T> {
    query(text).scalar()
}

/// Runs a statement in the language of its target.
macro_rules! on_target {
    ($statement:ident, $on:ident, |$query:ident, $target:ident| $run:expr) => {
        match $on.into() {
            Target::Sqlite($target) => {
                let $query = $statement.into_sqlite();
                $run
            }
            Target::SqlitePool($target) => {
                let $query = $statement.into_sqlite();
                $run
            }
            Target::Postgres($target) => {
                let $query = $statement.into_postgres();
                $run
            }
            Target::PostgresPool($target) => {
                let $query = $statement.into_postgres();
                $run
            }
        }
    };
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
        let rows = on_target!(self, on, |query, target| query.execute(target).await?.rows_affected());
        Ok(Changed { rows })
    }

    /// Its rows.
    pub(crate) async fn fetch_all(self, on: impl Into<Target<'_>>) -> Result<Vec<Row>, DatabaseError> {
        Ok(on_target!(self, on, |query, target| query.fetch_all(target).await?.into_iter().map(Row::from).collect()))
    }

    /// Its row, if there is one.
    pub(crate) async fn fetch_optional(self, on: impl Into<Target<'_>>) -> Result<Option<Row>, DatabaseError> {
        Ok(on_target!(self, on, |query, target| query.fetch_optional(target).await?.map(Row::from)))
    }

    /// Its row.
    pub(crate) async fn fetch_one(self, on: impl Into<Target<'_>>) -> Result<Row, DatabaseError> {
        self.fetch_optional(on).await?.ok_or_else(|| sqlx::Error::RowNotFound.into())
    }

    fn into_sqlite(self) -> Query<'static, Sqlite, SqliteArguments> {
        #[cfg(test)]
        super::postgres::tests::record(&self);
        let text = self.text.into_dialect(Dialect::Sqlite);
        #[cfg(test)]
        super::sent::record(text.as_str());
        let query = sqlx::query(text);
        self.values.into_iter().fold(query, |query, value| match value {
            Value::Integer(value) => query.bind(value),
            Value::Real(value) => query.bind(value),
            Value::Text(value) => query.bind(value),
            Value::Bytes(value) => query.bind(value),
        })
    }

    fn into_postgres(self) -> Query<'static, Postgres, PgArguments> {
        let text = self.text.into_dialect(Dialect::Postgres);
        #[cfg(test)]
        super::sent::record(text.as_str());
        let query = sqlx::query(text);
        self.values.into_iter().fold(query, |query, value| match value {
            Value::Integer(value) => query.bind(value),
            Value::Real(value) => query.bind(value),
            Value::Text(value) => query.bind(value),
            Value::Bytes(value) => query.bind(value),
        })
    }

    /// Its text, if it is written in the program, and its values.
    #[cfg(test)]
    pub(super) fn parts(&self) -> Option<(&'static str, &[Value])> {
        match self.text {
            Text::Written(text) => Some((text, &self.values)),
            Text::Made(_) => None,
        }
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
            Self::Made(text) => AssertSqlSafe(dialect::translate(&text, dialect)).into_sql_str(),
        }
    }
}
