//! Tokens of a text that is JSON with comments, each with the number of line breaks before it.

use std::ops::Range;

/// Kind of token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// `{` or `[`.
    Open,
    /// `}` or `]`.
    Close,
    Comma,
    Colon,
    /// A string, a number, or a word.
    Scalar,
    /// `// …`, without the end of its line.
    LineComment,
    /// `/* … */`.
    BlockComment,
}

/// A token of the text.
#[derive(Clone, Debug)]
pub(super) struct Token {
    pub kind: Kind,
    /// Its bytes in the text.
    pub range: Range<usize>,
    /// Line breaks since the token before, 2 for more than 2.
    pub breaks: u8,
}

/// Splits a text into tokens.
#[derive(Debug)]
pub(super) struct Lexer<'a> {
    bytes: &'a [u8],
    text: &'a str,
    next: Option<Token>,
}

impl<'a> Lexer<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        let mut lexer = Self { bytes: text.as_bytes(), text, next: None };
        lexer.next = lexer.scan(0);
        lexer
    }

    /// The next token, which stays.
    pub(super) fn peek(&self) -> Option<&Token> {
        self.next.as_ref()
    }

    /// The kind of the next token.
    pub(super) fn kind(&self) -> Option<Kind> {
        self.next.as_ref().map(|token| token.kind)
    }

    /// Takes the next token.
    pub(super) fn take(&mut self) -> Option<Token> {
        let token = self.next.take()?;
        self.next = self.scan(token.range.end);
        Some(token)
    }

    /// Takes the next token if it is of a kind.
    pub(super) fn take_if(&mut self, kind: Kind) -> Option<Token> {
        if self.kind() == Some(kind) { self.take() } else { None }
    }

    fn scan(&self, mut at: usize) -> Option<Token> {
        let mut breaks = 0;
        while let Some(byte) = self.bytes.get(at).filter(|byte| b" \t\r\n".contains(byte)) {
            breaks = if *byte == b'\n' { 2.min(breaks + 1) } else { breaks };
            at += 1;
        }
        let rest = &self.bytes[at..];
        let (kind, length) = match rest.first()? {
            b'{' | b'[' => (Kind::Open, 1),
            b'}' | b']' => (Kind::Close, 1),
            b',' => (Kind::Comma, 1),
            b':' => (Kind::Colon, 1),
            b'/' if rest.get(1) == Some(&b'/') => {
                let line = self.text[at..].split('\n').next().unwrap_or_default();
                (Kind::LineComment, line.trim_ascii_end().len())
            }
            b'/' => {
                let inside = self.text.get(at + 2..)?;
                (Kind::BlockComment, inside.find("*/")? + 4)
            }
            b'"' => (Kind::Scalar, string_length(rest)),
            _ => {
                let is_end = |byte: &u8| b" \t\r\n,:]}[{\"/".contains(byte);
                (Kind::Scalar, rest.iter().position(is_end).unwrap_or(rest.len()))
            }
        };
        Some(Token { kind, range: at..at + length, breaks })
    }
}

/// Length of the string that begins a text, with its quotes.
fn string_length(bytes: &[u8]) -> usize {
    let mut at = 1;
    while let Some(byte) = bytes.get(at) {
        match byte {
            b'"' => return at + 1,
            b'\\' => at += 2,
            _ => at += 1,
        }
    }
    bytes.len()
}
