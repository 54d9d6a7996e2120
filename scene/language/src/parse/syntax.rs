//! Explains syntax errors of JSON written by hand: a comment, an extra comma, a missing quote.

use serde::de::IgnoredAny;

use super::plain_json;
use crate::error::{LineIndex, ValidationError};

/// Words of other languages, and their JSON equivalents.
const WORDS: [(&str, &str); 6] = [
    ("True", "true"),
    ("False", "false"),
    ("None", "null"),
    ("undefined", "null"),
    ("TRUE", "true"),
    ("FALSE", "false"),
];

/// The error of a text that is no tree, which is read again to explain it.
pub(super) fn explain(text: &str) -> ValidationError {
    let plain = plain_json(text);
    match serde_json::from_str::<IgnoredAny>(&plain) {
        Err(error) => fault(&plain, &error),
        Ok(_) => LineIndex::new(text).fault(0, String::new(), "is larger than 2 GiB: make it smaller".to_owned()),
    }
}

/// The error of a text that serde cannot parse.
fn fault(text: &str, error: &serde_json::Error) -> ValidationError {
    let lines = LineIndex::new(text);
    let reached = lines.offset(error.line(), error.column());
    // Serde did not stop at an oddity after its own position.
    if let Some(SyntaxOddity { offset, message }) = first_oddity(text).filter(|oddity| oddity.offset <= reached + 1) {
        return lines.fault(offset, String::new(), message);
    }
    ValidationError {
        pointer: String::new(),
        message: words(&super::form::message(error)),
        line: error.line() as u32,
        column: error.column().max(1) as u32,
    }
}

/// The message of serde, with a fix added if it has none.
fn words(message: &str) -> String {
    let cure = match message {
        "key must be a string" => "write it in double quotes",
        "expected value" => "write a number, a string in double quotes, a list, an object, true, false or null",
        "expected `:`" => "write a colon between a key and its value",
        "invalid escape" => "write a backslash as \\\\",
        "invalid number" => "write it as in 0.5, -1 or 2e3",
        _ => return message.to_owned(),
    };
    format!("{message}: {cure}")
}

/// Syntax that JSON does not have.
struct SyntaxOddity {
    offset: usize,
    message: String,
}

/// A token of the text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Token {
    /// A string, a number, a word, or the end of a list or an object.
    Value,
    /// A string that is a key.
    Key,
    Colon,
    Comma,
    Open,
    /// Start of the text.
    Start,
}

/// Scans a text up to the first oddity.
struct Scanner<'a> {
    text: &'a str,
    bytes: &'a [u8],
    at: usize,
    before: Token,
    /// Byte offsets of the open lists and objects.
    open: Vec<usize>,
    /// The first bracket whose line is not indented as that of the bracket that closes it.
    suspect: Option<usize>,
}

fn first_oddity(text: &str) -> Option<SyntaxOddity> {
    let mut scanner =
        Scanner { text, bytes: text.as_bytes(), at: 0, before: Token::Start, open: Vec::new(), suspect: None };
    loop {
        scanner.at += scanner.blanks_at(scanner.at);
        let Some(&byte) = scanner.bytes.get(scanner.at) else { return Some(scanner.end()) };
        if let Some(message) = scanner.token(byte) {
            return Some(SyntaxOddity { offset: scanner.at, message });
        }
    }
}

impl Scanner<'_> {
    fn blanks_at(&self, at: usize) -> usize {
        self.bytes[at..].iter().take_while(|byte| b" \t\r\n".contains(byte)).count()
    }

    /// The oddity of the token here, if it is one; otherwise the scan moves past the token.
    fn token(&mut self, byte: u8) -> Option<String> {
        match byte {
            b'/' if self.bytes.get(self.at + 1) == Some(&b'*') => {
                Some("a comment that does not end: write */ after it".to_owned())
            }
            b'#' => Some("a comment begins with //: write // instead of #".to_owned()),
            b'<' if self.text[self.at..].starts_with("<!--") => {
                Some("a comment begins with //: write // instead of <!--".to_owned())
            }
            b':' if self.before == Token::Value && self.is_in_list() => Some(format!(
                "a key in a list: the {}: write it, or remove the key",
                self.lacks(self.open.last().copied().unwrap_or_default())
            )),
            b':' => self.pass(1, Token::Colon),
            _ if self.before == Token::Key => {
                Some("a colon is missing after a key: write : before its value".to_owned())
            }
            b',' => self.comma(),
            b'}' | b']' => self.close(byte),
            b'+' | b'*' | b'/' | b'^' | b'%' | b'(' if self.before == Token::Value && !self.open.is_empty() => {
                Some(r#"a calculation is a formula: write { "expr": "1 / 2" }"#.to_owned())
            }
            _ if self.before == Token::Value => Some(if self.open.is_empty() {
                "text after the end of the job: a file has one job, remove the rest".to_owned()
            } else {
                "a comma is missing before this: write one".to_owned()
            }),
            b'{' | b'[' => {
                self.open.push(self.at);
                self.pass(1, Token::Open)
            }
            b'"' => self.string(),
            b'\'' => Some("single quotes are invalid in JSON: write \" instead".to_owned()),
            b'0'..=b'9' | b'-' | b'+' | b'.' => self.number(),
            _ => self.word(),
        }
    }

    fn pass(&mut self, bytes: usize, token: Token) -> Option<String> {
        self.at += bytes;
        self.before = token;
        None
    }

    fn is_in_list(&self) -> bool {
        self.open.last().is_some_and(|&open| self.bytes[open] == b'[')
    }

    fn close(&mut self, byte: u8) -> Option<String> {
        let Some(open) = self.open.pop() else {
            let (open, close) = if byte == b'}' { ("{", "}") } else { ("[", "]") };
            return Some(format!("this `{close}` closes no `{open}`: remove it"));
        };
        if (self.bytes[open] == b'{') != (byte == b'}') {
            return Some(format!("the {}: write it before this `{}`", self.lacks(open), char::from(byte)));
        }
        let indent = |at: usize| {
            let line = self.text[..at].rfind('\n').map_or(0, |newline| newline + 1);
            self.blanks_at(line)
        };
        let is_first = self.text[..self.at].trim_end_matches([' ', '\t', '\r']).ends_with('\n');
        if is_first && indent(open) != indent(self.at) {
            self.suspect.get_or_insert(open);
        }
        self.pass(1, Token::Value)
    }

    /// "`{` at 2:5 lacks its `}`".
    fn lacks(&self, open: usize) -> String {
        let place = LineIndex::new(&self.text[..open]).fault(open, String::new(), String::new());
        let (bracket, close) = if self.bytes[open] == b'{' { ("{", "}") } else { ("[", "]") };
        format!("`{bracket}` at {}:{} lacks its `{close}`", place.line, place.column)
    }

    fn comma(&mut self) -> Option<String> {
        let next = self.at + 1 + self.blanks_at(self.at + 1);
        match self.bytes.get(next) {
            Some(b'}' | b']') => {
                Some(format!("trailing comma: remove the comma before `{}`", char::from(self.bytes[next])))
            }
            Some(b',') => Some("two commas in a row: remove one".to_owned()),
            _ if matches!(self.before, Token::Open | Token::Colon) => {
                Some("a comma without a value before it: remove it, or write a value".to_owned())
            }
            _ => self.pass(1, Token::Comma),
        }
    }

    fn string(&mut self) -> Option<String> {
        let mut end = self.at + 1;
        loop {
            match self.bytes.get(end) {
                Some(b'"') => {
                    let is_key = matches!(self.before, Token::Open | Token::Comma) && !self.is_in_list();
                    return self.pass(end + 1 - self.at, if is_key { Token::Key } else { Token::Value });
                }
                Some(b'\\') => end += 2,
                Some(b'\n') | None => {
                    return Some("unterminated string: write \" at its end; a new line in it is \\n".to_owned());
                }
                Some(_) => end += 1,
            }
        }
    }

    fn number(&mut self) -> Option<String> {
        let rest = &self.bytes[self.at..];
        let length = rest.iter().take_while(|byte| byte.is_ascii_alphanumeric() || b"+-._".contains(byte)).count();
        let number = &self.text[self.at..self.at + length];
        if is_number(number) {
            return self.pass(length, Token::Value);
        }
        Some(format!("{} is not a JSON number: write it as in 0.5, -1 or 2e3", quoted(number)))
    }

    fn word(&mut self) -> Option<String> {
        let rest = &self.text[self.at..];
        let end = rest.find(|letter: char| !letter.is_alphanumeric() && letter != '_' && letter != '-');
        let word = &rest[..end.unwrap_or(rest.len())];
        if matches!(word, "true" | "false" | "null") {
            return self.pass(word.len(), Token::Value);
        }
        let behind = self.at + word.len();
        if rest.starts_with(['“', '”', '„', '‘', '’', '«', '»']) {
            return Some("typographic quotes are invalid in JSON: write \" instead".to_owned());
        }
        if self.bytes.get(behind) == Some(&b'(') {
            return Some(format!(r#"a calculation is a formula: write {{ "expr": "{}(…)" }}"#, quoted(word)));
        }
        if word.is_empty() {
            // The parser reports it.
            self.at = self.bytes.len();
            return None;
        }
        if self.bytes.get(behind + self.blanks_at(behind)) == Some(&b':') {
            return Some(format!("a key needs double quotes: write {}", serde_json::Value::from(word)));
        }
        if let Some((_, ours)) = WORDS.iter().find(|(theirs, _)| *theirs == word) {
            return Some(format!("{word} is not a JSON word: write {ours}"));
        }
        if matches!(word, "NaN" | "Infinity" | "inf" | "nan") {
            return Some(format!("{word} is not a JSON number: write a finite one"));
        }
        Some(format!("{} is not a JSON word: write text in double quotes", quoted(word)))
    }

    /// The text ends before the job is complete.
    fn end(&self) -> SyntaxOddity {
        let message = match self.open.last() {
            Some(&open) => match self.suspect {
                Some(suspect) => format!("the text ends too early (EOF): probably the {}", self.lacks(suspect)),
                None => format!("the text ends too early (EOF): the {}", self.lacks(open)),
            },
            None => "the text ends too early (EOF): write a job, which is one JSON object".to_owned(),
        };
        SyntaxOddity { offset: self.text.trim_end().len().saturating_sub(1), message }
    }
}

/// Whether JSON allows a number to be written so, however large it is.
fn is_number(text: &str) -> bool {
    let unsigned = text.strip_prefix('-').unwrap_or(text);
    let (mantissa, exponent) = unsigned.split_once(['e', 'E']).map_or((unsigned, None), |(m, e)| (m, Some(e)));
    let (whole, fraction) = mantissa.split_once('.').map_or((mantissa, None), |(w, f)| (w, Some(f)));
    let is_digits = |digits: &str| !digits.is_empty() && digits.bytes().all(|digit| digit.is_ascii_digit());
    is_digits(whole)
        && (whole == "0" || !whole.starts_with('0'))
        && fraction.is_none_or(is_digits)
        && exponent.is_none_or(|exponent| is_digits(exponent.strip_prefix(['+', '-']).unwrap_or(exponent)))
}

/// Text, shortened for a message.
fn quoted(text: &str) -> String {
    const MAX_CHARS: usize = 40;
    if text.chars().count() <= MAX_CHARS {
        return text.to_owned();
    }
    text.chars().take(MAX_CHARS).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_form_that_json_allows() {
        for number in ["0", "-0", "7", "10", "0.5", "-1.25e3", "1E+9", "2e-07", "1e400"] {
            assert!(is_number(number), "{number}");
        }
        for other in ["", "-", "01", "00", "+1", ".5", "1.", "1e", "1e+", "0x10", "1_000", "1,5", "NaN", "--1"] {
            assert!(!is_number(other), "{other}");
        }
    }

    /// Line, column and message of the error of a text.
    fn of(text: &str) -> (u32, u32, String) {
        let error = serde_json::from_str::<IgnoredAny>(text).expect_err(text);
        let ValidationError { line, column, message, .. } = fault(text, &error);
        (line, column, message)
    }

    #[test]
    fn common_syntax_mistakes_are_explained_at_their_position() {
        for (text, line, column, words) in [
            ("{\"a\": 1,\n}", 1, 8, "trailing comma"),
            ("[1, 2 , ]", 1, 7, "before `]`"),
            ("{\"a\": 1, /* b \"b\": 2}", 1, 10, "write */"),
            ("{\"a\": 1 # b\n}", 1, 9, "write // instead of #"),
            ("{\"a\": [1}", 1, 9, "the `[` at 1:7 lacks its `]`"),
            ("{\"a\": {\"b\": 1]", 1, 14, "the `{` at 1:7 lacks its `}`"),
            ("{\"a\": [1, \"b\": 2}", 1, 14, "the `[` at 1:7 lacks its `]`"),
            ("{} }", 1, 4, "closes no `{`"),
            (
                "{\n  \"a\": { \"b\": {\n    \"c\": 1\n  },\n  \"d\": {\n    \"e\": { \"f\": 1\n  }\n}",
                8,
                1,
                "probably the `{` at 6:10",
            ),
            ("{\"a\": 1/2}", 1, 8, "a formula"),
            ("{\"a\": sin(30)}", 1, 7, "a formula"),
            ("{'a': 1}", 1, 2, "single quotes"),
            ("{a: 1}", 1, 2, "write \"a\""),
            ("{\"a\": yes}", 1, 7, "double quotes"),
            ("{\"a\": True}", 1, 7, "write true"),
            ("{\"a\": NaN}", 1, 7, "NaN"),
            ("{\"a\": .5}", 1, 7, ".5 is not a JSON number"),
            ("{\"a\": 0x10}", 1, 7, "0x10 is not a JSON number"),
            ("[1,, 2]", 1, 3, "two commas"),
            ("[, 1]", 1, 2, "without a value"),
            ("{\"a\": 1\n \"b\": 2}", 2, 2, "comma is missing"),
            ("{} {}", 1, 4, "one job"),
            ("{\"a\": \"b\n\"}", 1, 7, "unterminated string"),
            ("{\"a\": [1", 1, 8, "the `[` at 1:7 lacks its `]`"),
            ("", 1, 1, "EOF"),
            ("{\"a\" 1}", 1, 6, "colon is missing"),
            ("{\"a\": \"\\q\"}", 1, 9, "\\\\"),
            ("{1: 2}", 1, 2, "double quotes"),
        ] {
            let (at_line, at_column, message) = of(text);
            assert!(message.contains(words), "{text}: {message}");
            assert_eq!((at_line, at_column), (line, column), "{text}: {message}");
        }
    }

    #[test]
    fn odd_characters_inside_a_string_are_valid() {
        let (line, column, message) = of("{\"a\": \"// b, ]\", \"c\": \"'\",}");
        assert!(message.contains("trailing comma") && (line, column) == (1, 26), "{message} at {column}");
    }
}
