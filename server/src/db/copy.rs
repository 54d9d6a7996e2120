//! Copies a farm from one database to an empty one of another engine: every row of every table.
//!
//! Tables, columns and their order come from the catalog of the file, which is one of the two; a test compares the tables of
//! both engines, so no list is kept here.

use super::value::{Cell, Value};
use super::{Connection, Database, DatabaseError, Durability, Readers, Row, made_query, query};

/// Maximum number of rows read at once.
const PAGE_ROWS: i64 = 5_000;
/// Maximum number of parameters of a statement that writes rows; every engine takes more.
const MAX_PARAMETERS: usize = 1_000;

/// A table, and the columns that are copied.
#[derive(Clone, Debug)]
struct Table {
    name: String,
    columns: Vec<TableColumn>,
    /// Column of numbers that the engine gives to new rows.
    number: Option<String>,
}

#[derive(Clone, Debug)]
struct TableColumn {
    name: String,
    /// Type in the file: `INTEGER`, `REAL`, `TEXT` or `BLOB`.
    kind: String,
    is_key: bool,
}

impl Database {
    /// Whether the farm has no job and no key.
    pub(crate) async fn is_empty(&self) -> Result<bool, DatabaseError> {
        let used = "SELECT EXISTS (SELECT 1 FROM job) OR EXISTS (SELECT 1 FROM key)";
        query(used).scalar::<bool>().fetch_one(self.readers()).await.map(|used| !used)
    }

    /// Copies every row of this database to `target`, which must be empty and of another engine, in one transaction; returns
    /// their number.
    pub(crate) async fn copy_to(&self, target: &Self) -> Result<u64, DatabaseError> {
        let file = if let Readers::Sqlite(_) = self.readers() { self } else { target };
        let tables = tables(file.readers()).await?;
        let newest = newest_numbers(self.readers(), &tables).await?;
        let source = self.readers().clone();
        let copy = target.write(Durability::Full, move |connection| {
            Box::pin(async move { copy_tables(&source, &tables, &newest, connection).await })
        });
        copy.await
    }
}

async fn copy_tables(
    source: &Readers,
    tables: &[Table],
    newest: &[i64],
    target: &mut Connection,
) -> Result<u64, DatabaseError> {
    // Both databases have rows that their migrations have made.
    for table in tables.iter().rev() {
        made_query(format!("DELETE FROM {}", table.name)).execute(&mut *target).await?;
    }
    let mut rows = 0;
    for (table, newest) in tables.iter().zip(newest) {
        rows += copy_table(source, table, target).await?;
        continue_numbers(target, table, *newest).await?;
    }
    Ok(rows)
}

/// The tables of a file, each after those that it refers to.
async fn tables(file: &Readers) -> Result<Vec<Table>, DatabaseError> {
    let names = query(
        "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite\\_%' ESCAPE '\\'
         AND name NOT LIKE '\\_sqlx\\_%' ESCAPE '\\' ORDER BY name",
    );
    let mut waiting = names.scalar::<String>().fetch_all(file).await?;
    let references = query(
        "SELECT DISTINCT source.name, target.\"table\" AS target
         FROM sqlite_master AS source CROSS JOIN pragma_foreign_key_list(source.name) AS target
         WHERE source.type = 'table' AND source.name <> target.\"table\"",
    );
    let mut references: Vec<(String, String)> = (references.fetch_all(file).await?.iter())
        .map(|row| Ok((row.get("name")?, row.get("target")?)))
        .collect::<Result<_, DatabaseError>>()?;
    let mut tables = Vec::with_capacity(waiting.len());
    while !waiting.is_empty() {
        let is_ready = |name: &String| !references.iter().any(|(source, _)| source == name);
        let (ready, rest): (Vec<String>, Vec<String>) = waiting.into_iter().partition(is_ready);
        if ready.is_empty() {
            return Err(sqlx::Error::Protocol(format!("the tables {rest:?} refer to each other")).into());
        }
        references.retain(|(_, target)| !ready.contains(target));
        for name in ready {
            tables.push(table(file, name).await?);
        }
        waiting = rest;
    }
    Ok(tables)
}

async fn table(file: &Readers, name: String) -> Result<Table, DatabaseError> {
    let columns = query("SELECT name, upper(type) AS kind, pk FROM pragma_table_info(?)").bind(&name).fetch_all(file);
    let columns: Vec<TableColumn> = (columns.await?.iter())
        .map(|row| {
            let key: i64 = row.get("pk")?;
            Ok(TableColumn { name: row.get("name")?, kind: row.get("kind")?, is_key: key > 0 })
        })
        .collect::<Result<_, DatabaseError>>()?;
    let mut keys = columns.iter().filter(|column| column.is_key);
    let number = keys.next().filter(|column| column.kind == "INTEGER" && keys.next().is_none());
    // A number that refers to another table is not given by the engine.
    let refers = query("SELECT count(*) FROM pragma_foreign_key_list(?) WHERE \"from\" = ?").bind(&name);
    let refers = refers.bind(number.map_or("", |column| &column.name)).scalar::<i64>().fetch_one(file).await?;
    let number = number.filter(|_| refers == 0).map(|column| column.name.clone());
    Ok(Table { name, columns, number })
}

/// The highest number that each table's rows ever had: numbers of deleted rows are not given again.
async fn newest_numbers(source: &Readers, tables: &[Table]) -> Result<Vec<i64>, DatabaseError> {
    let mut newest = Vec::with_capacity(tables.len());
    for table in tables {
        let Some(number) = &table.number else {
            newest.push(0);
            continue;
        };
        let name = &table.name;
        let given = match source {
            Readers::Sqlite(_) => query("SELECT max(seq) FROM sqlite_sequence WHERE name = ?").bind(name),
            Readers::Postgres(_) => query(
                "SELECT last_value FROM pg_sequences WHERE schemaname = current_schema() AND sequencename = ? || '_' || ? || '_seq'",
            )
            .bind(name)
            .bind(number),
        };
        let given: Option<Option<i64>> = given.scalar().fetch_optional(source).await?;
        let highest = made_query(format!("SELECT coalesce(max({number}), 0) FROM {name}"));
        let highest: i64 = highest.scalar().fetch_one(source).await?;
        newest.push(given.flatten().unwrap_or(0).max(highest));
    }
    Ok(newest)
}

async fn copy_table(source: &Readers, table: &Table, target: &mut Connection) -> Result<u64, DatabaseError> {
    let names: Vec<String> = table.columns.iter().map(|column| format!("\"{}\"", column.name)).collect();
    let keys = table.columns.iter().filter(|column| column.is_key).map(|column| format!("\"{}\"", column.name));
    let order = keys.collect::<Vec<_>>().join(", ");
    let (names, mut copied) = (names.join(", "), 0);
    loop {
        let page = format!("SELECT {names} FROM {} ORDER BY {order} LIMIT ? OFFSET ?", table.name);
        let rows = made_query(page).bind(PAGE_ROWS).bind(copied).fetch_all(source).await?;
        for rows in rows.chunks((MAX_PARAMETERS / table.columns.len()).max(1)) {
            let row = format!("({})", vec!["?"; table.columns.len()].join(", "));
            let all = vec![row; rows.len()].join(", ");
            let mut insert = made_query(format!("INSERT INTO {} ({names}) VALUES {all}", table.name));
            for row in rows {
                for (index, column) in table.columns.iter().enumerate() {
                    let cell = row.get(index)?;
                    if matches!((&cell, &*target), (Cell::Text(text), Connection::Postgres(_)) if text.contains('\0')) {
                        return Err(unstorable(table, row, column));
                    }
                    insert = insert.bind(value(cell, &column.kind)?);
                }
            }
            insert.execute(&mut *target).await?;
        }
        copied += i64::try_from(rows.len()).unwrap_or(PAGE_ROWS);
        if rows.len() < PAGE_ROWS as usize {
            return Ok(copied.unsigned_abs());
        }
    }
}

/// Error for a row with a text that PostgreSQL cannot store, named by its numbers and ids.
fn unstorable(table: &Table, row: &Row, column: &TableColumn) -> DatabaseError {
    let names = |named: &(usize, &TableColumn)| named.1.is_key || ["id", "job"].contains(&named.1.name.as_str());
    let named = table.columns.iter().enumerate().filter(names).filter_map(|(index, key)| match row.get(index) {
        Ok(Cell::Integer(number)) => Some(format!("{} {number}", key.name)),
        Ok(Cell::Text(text)) => Some(format!("{} {text}", key.name)),
        Ok(Cell::Null | Cell::Real(_) | Cell::Bytes(_)) | Err(_) => None,
    });
    let (named, table, column) = (named.collect::<Vec<_>>().join(", "), &table.name, &column.name);
    let message = format!(
        "the {column} of this {table} has the character U+0000, which PostgreSQL cannot store: {named}; start the farm \
         with its file, delete that job, and move it then"
    );
    sqlx::Error::Encode(message.into()).into()
}

/// A cell as the value of a column of this type.
fn value(cell: Cell, kind: &str) -> Result<Value, DatabaseError> {
    Ok(match (kind, cell) {
        ("INTEGER", Cell::Null) => Value::Integer(None),
        ("INTEGER", Cell::Integer(value)) => Value::Integer(Some(value)),
        ("REAL", Cell::Null) => Value::Real(None),
        ("REAL", Cell::Real(value)) => Value::Real(Some(value)),
        ("TEXT", Cell::Null) => Value::Text(None),
        ("TEXT", Cell::Text(value)) => Value::Text(Some(value)),
        ("BLOB", Cell::Null) => Value::Bytes(None),
        ("BLOB", Cell::Bytes(value)) => Value::Bytes(Some(value)),
        (kind, cell) => {
            return Err(sqlx::Error::Decode(format!("a column of type {kind} has the value {cell:?}").into()).into());
        }
    })
}

/// Has the engine number new rows after the newest one.
async fn continue_numbers(connection: &mut Connection, table: &Table, newest: i64) -> Result<(), DatabaseError> {
    let (Some(number), true) = (&table.number, newest > 0) else { return Ok(()) };
    connection.number_after(&table.name, number, newest).await
}

impl Connection {
    /// Has the engine number new rows of a table after this number; a table that it does not number is left alone.
    pub(crate) async fn number_after(&mut self, table: &str, column: &str, newest: i64) -> Result<(), DatabaseError> {
        let statement = match self {
            Self::Sqlite(_) => query("UPDATE sqlite_sequence SET seq = ?1 WHERE name = ?2").bind(newest).bind(table),
            Self::Postgres(_) => {
                query("SELECT setval(pg_get_serial_sequence(?2, ?3), ?1)").bind(newest).bind(table).bind(column)
            }
        };
        let changed = statement.execute(&mut *self).await?;
        if let Self::Sqlite(_) = self
            && changed.rows_affected() == 0
        {
            // Only tables with AUTOINCREMENT have a row there, and only after their first row.
            let insert = "INSERT INTO sqlite_sequence (name, seq) SELECT name, ? FROM sqlite_master
                          WHERE name = ? AND sql LIKE '%AUTOINCREMENT%'";
            query(insert).bind(newest).bind(table).execute(self).await?;
        }
        Ok(())
    }
}
