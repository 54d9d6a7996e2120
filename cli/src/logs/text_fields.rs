//! Formats the fields of text logs: values from outside cannot control a terminal or forge a line.
//!
//! The text format writes values of `Display` as they are, and so also names and messages of users and workers.

use std::fmt;

use proto::plain_text::escape_line;
use tracing::field::{Field, Visit};
use tracing_subscriber::field::{RecordFields, VisitOutput};
use tracing_subscriber::fmt::format::{FormatFields, Writer};

/// Writes fields as `name=value`, and the message as it is, with control characters as escapes.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlainFields;

impl<'writer> FormatFields<'writer> for PlainFields {
    fn format_fields<R: RecordFields>(&self, writer: Writer<'writer>, fields: R) -> fmt::Result {
        let mut visitor = PlainVisitor { writer, is_first: true, result: Ok(()) };
        fields.record(&mut visitor);
        visitor.finish()
    }
}

struct PlainVisitor<'writer> {
    writer: Writer<'writer>,
    is_first: bool,
    result: fmt::Result,
}

impl PlainVisitor<'_> {
    fn write(&mut self, field: &Field, value: &str) {
        if self.result.is_err() || field.name().starts_with("log.") {
            return;
        }
        let gap = if self.is_first { "" } else { " " };
        self.is_first = false;
        let value = escape_line(value);
        self.result = match field.name().trim_start_matches("r#") {
            "message" => write!(self.writer, "{gap}{value}"),
            name if self.writer.has_ansi_escapes() => write!(self.writer, "{gap}\u{1b}[3m{name}\u{1b}[0m={value}"),
            name => write!(self.writer, "{gap}{name}={value}"),
        };
    }
}

impl Visit for PlainVisitor<'_> {
    fn record_str(&mut self, field: &Field, value: &str) {
        if field.name() == "message" {
            self.write(field, value);
        } else {
            self.write(field, &format!("{value:?}"));
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        self.write(field, &format!("{value:?}"));
    }
}

impl VisitOutput<fmt::Result> for PlainVisitor<'_> {
    fn finish(self) -> fmt::Result {
        self.result
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::{Arc, Mutex};

    use super::*;

    #[derive(Clone, Default)]
    struct Lines(Arc<Mutex<Vec<u8>>>);

    impl Write for Lines {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().expect("no holder panics").write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn values_from_outside_forge_no_line_and_control_no_terminal() {
        let lines = Lines::default();
        let writer = lines.clone();
        let subscriber = tracing_subscriber::fmt()
            .with_writer(move || writer.clone())
            .with_ansi(false)
            .without_time()
            .fmt_fields(PlainFields)
            .finish();
        let evil = "a\u{1b}]0;owned\u{7}\nINFO forged: line\u{202e}";
        tracing::subscriber::with_default(subscriber, || {
            let span = tracing::info_span!("request", name = %evil);
            let _entered = span.enter();
            tracing::info!(worker = %evil, text = evil, debug = ?evil, "{evil}");
        });
        let text = String::from_utf8(lines.0.lock().expect("no holder panics").clone()).expect("text");
        assert_eq!(text.lines().count(), 1, "{text}");
        assert!(
            !text.trim_end().contains(|character: char| character.is_control() || character == '\u{202e}'),
            "{text:?}"
        );
        assert!(text.contains("worker=a\\u{1b}]0;owned\\u{7}\\nINFO forged"), "{text}");
    }
}
