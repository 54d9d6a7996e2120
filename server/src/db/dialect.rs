//! The language of statements: the SQL that both engines understand, with `?` or `?1` for parameters, and a handful of
//! named fragments where they differ.
//!
//! | Fragment | SQLite | PostgreSQL |
//! |---|---|---|
//! | `@texts(?)`, `@numbers(?)` | `json_each(?) AS listed` | the elements of a JSON list, as rows `listed (value)` |
//! | `@rows(?)` | `json_each(?) AS listed` | the same of lists in a list: `CAST(listed.value ->> 0 AS BIGINT)` |
//! | `IN (SELECT value FROM @texts(?))` | the same | `= ANY(ARRAY(…))`, which looks each element up in an index |
//! | `@unindexed(COLUMN)` | `+COLUMN` | `(COLUMN || '')`: a text that no index has, so that rows are found by another condition |
//! | `@index(NAME)` | `INDEXED BY NAME` | nothing |
//! | `@join` | `CROSS JOIN`, which keeps the order of tables | `JOIN` |
//! | `@max(`, `@min(` | `max(`, `min(` | `greatest(`, `least(`; no argument may be null: SQLite would give null |

use std::collections::HashMap;
use std::sync::{LazyLock, RwLock};

/// Engine whose language a text is translated to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Dialect {
    /// `SQLite`.
    Sqlite,
    /// PostgreSQL.
    Postgres,
}

/// Translations of the texts that are written in the program, so their number is bounded.
static TRANSLATED: LazyLock<RwLock<HashMap<(&'static str, Dialect), &'static str>>> = LazyLock::new(RwLock::default);

/// Translation of a text that is written in the program.
pub(super) fn written(text: &'static str, dialect: Dialect) -> &'static str {
    if dialect == Dialect::Sqlite && !text.contains('@') {
        return text;
    }
    if let Some(translated) = TRANSLATED.read().expect("no holder panics").get(&(text, dialect)) {
        return translated;
    }
    let translated = translate(text, dialect);
    TRANSLATED.write().expect("no holder panics").entry((text, dialect)).or_insert_with(|| translated.leak())
}

/// Translates a text.
pub(crate) fn translate(text: &str, dialect: Dialect) -> String {
    let mut translation =
        Translation { dialect, rest: text, out: String::with_capacity(text.len() * 2), unnumbered: 0 };
    while translation.step() {}
    translation.out
}

struct Translation<'t> {
    dialect: Dialect,
    rest: &'t str,
    out: String,
    /// Number of parameters without a number so far.
    unnumbered: u32,
}

impl Translation<'_> {
    /// Translates up to and including the next quoted text, parameter or fragment; false at the end.
    fn step(&mut self) -> bool {
        let Some(at) = self.rest.find(['\'', '?', '@']) else {
            self.out.push_str(self.rest);
            return false;
        };
        self.out.push_str(&self.rest[..at]);
        let special = self.rest.as_bytes()[at];
        self.rest = &self.rest[at + 1..];
        match special {
            b'\'' => {
                let end = self.rest.find('\'').map_or(self.rest.len(), |end| end + 1);
                self.out.push('\'');
                self.out.push_str(&self.rest[..end]);
                self.rest = &self.rest[end..];
            }
            b'?' => {
                let parameter = self.parameter();
                self.out.push_str(&parameter);
            }
            _ => self.fragment(),
        }
        true
    }

    /// Takes the number of a parameter, if it has one.
    fn parameter(&mut self) -> String {
        let digits = self.rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(self.rest.len());
        let (number, rest) = self.rest.split_at(digits);
        self.rest = rest;
        match (self.dialect, number) {
            (Dialect::Sqlite, number) => format!("?{number}"),
            (Dialect::Postgres, "") => {
                self.unnumbered += 1;
                format!("${}", self.unnumbered)
            }
            (Dialect::Postgres, number) => format!("${number}"),
        }
    }

    fn fragment(&mut self) {
        let end = self.rest.find(|c: char| !c.is_ascii_lowercase()).unwrap_or(self.rest.len());
        let (name, rest) = self.rest.split_at(end);
        self.rest = rest;
        let text = match (name, self.dialect) {
            ("join", Dialect::Sqlite) => "CROSS JOIN".to_owned(),
            ("join", Dialect::Postgres) => "JOIN".to_owned(),
            ("max" | "min", Dialect::Sqlite) => name.to_owned(),
            ("max", Dialect::Postgres) => "greatest".to_owned(),
            ("min", Dialect::Postgres) => "least".to_owned(),
            ("index", dialect) => {
                let index = self.argument();
                if dialect == Dialect::Sqlite { format!("INDEXED BY {index}") } else { String::new() }
            }
            ("unindexed", dialect) => {
                let column = self.argument();
                if dialect == Dialect::Sqlite { format!("+{column}") } else { format!("({column} || '')") }
            }
            ("texts" | "numbers" | "rows", dialect) => {
                let list = self.list_argument();
                match (dialect, self.out.strip_suffix(AMONG), self.rest.strip_prefix(')')) {
                    (Dialect::Postgres, Some(before), Some(rest)) if !before.ends_with("NOT ") => {
                        let (length, elements) = (before.len(), elements_of(name, &list));
                        self.out.truncate(length);
                        self.rest = rest;
                        format!("= ANY(ARRAY(SELECT {elements}))")
                    }
                    _ => list_of(name, &list, dialect),
                }
            }
            _ => unreachable!("the language of statements has no @{name}"),
        };
        self.out.push_str(&text);
    }

    /// Takes a word in parentheses.
    fn argument(&mut self) -> String {
        let end = self.rest.find(')').expect("a fragment's argument ends");
        let word = self.rest[1..end].to_owned();
        self.rest = &self.rest[end + 1..];
        word
    }

    /// Takes a parameter in parentheses.
    fn list_argument(&mut self) -> String {
        self.rest = self.rest.strip_prefix("(?").expect("a list is a parameter");
        let parameter = self.parameter();
        self.rest = self.rest.strip_prefix(')').expect("a fragment's argument ends");
        parameter
    }
}

/// Beginning of a condition on the elements of a list.
const AMONG: &str = "IN (SELECT value FROM ";

/// Rows of a JSON list, as a table `listed` with the column `value`. PostgreSQL's planner expects few elements of an
/// array, and a hundred of a list, for which it reads whole tables that were small once.
fn list_of(kind: &str, list: &str, dialect: Dialect) -> String {
    match dialect {
        Dialect::Sqlite => format!("json_each({list}) AS listed"),
        Dialect::Postgres => format!("unnest(ARRAY(SELECT {})) AS listed (value)", elements_of(kind, list)),
    }
}

/// Elements of a JSON list, for PostgreSQL.
fn elements_of(kind: &str, list: &str) -> String {
    match kind {
        "texts" => format!("jsonb_array_elements_text(CAST({list} AS JSONB))"),
        "rows" => format!("jsonb_array_elements(CAST({list} AS JSONB))"),
        _ => format!("CAST(jsonb_array_elements_text(CAST({list} AS JSONB)) AS BIGINT)"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_numbered_in_their_order_and_quoted_text_is_left_alone() {
        let text = "UPDATE job SET name = ?, note = 'why? @join' WHERE id = ? AND submitter = ?";
        assert_eq!(translate(text, Dialect::Sqlite), text);
        assert_eq!(
            translate(text, Dialect::Postgres),
            "UPDATE job SET name = $1, note = 'why? @join' WHERE id = $2 AND submitter = $3"
        );
        assert_eq!(translate("SELECT ?2 + ?1", Dialect::Postgres), "SELECT $2 + $1");
    }

    #[test]
    fn fragments_are_written_for_each_engine() {
        let text = "SELECT @max(a, b) FROM @rows(?1) @join t @index(t_by_a) ON t.id IN (SELECT value FROM @texts(?2))";
        assert_eq!(
            translate(text, Dialect::Sqlite),
            "SELECT max(a, b) FROM json_each(?1) AS listed CROSS JOIN t INDEXED BY t_by_a ON t.id IN (SELECT value FROM json_each(?2) AS listed)"
        );
        assert_eq!(
            translate(text, Dialect::Postgres),
            "SELECT greatest(a, b) FROM unnest(ARRAY(SELECT jsonb_array_elements(CAST($1 AS JSONB)))) AS listed (value) JOIN t  ON t.id = ANY(ARRAY(SELECT jsonb_array_elements_text(CAST($2 AS JSONB))))"
        );
        let text = "@unindexed(t.a) IS NULL AND t.id NOT IN (SELECT value FROM @numbers(?))";
        assert_eq!(
            translate(text, Dialect::Sqlite),
            "+t.a IS NULL AND t.id NOT IN (SELECT value FROM json_each(?) AS listed)"
        );
        assert_eq!(
            translate(text, Dialect::Postgres),
            "(t.a || '') IS NULL AND t.id NOT IN (SELECT value FROM unnest(ARRAY(SELECT CAST(jsonb_array_elements_text(CAST($1 AS JSONB)) AS BIGINT))) AS listed (value))"
        );
    }
}
