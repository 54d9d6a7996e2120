//! Tokens of a tree, with its comments, commas and colons, each with the number of line breaks before it.

use std::ops::Range;

use crate::json::Tree;

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

/// Lists the tokens of a tree.
#[derive(Debug)]
pub(super) struct Lexer<'a> {
    tree: &'a Tree<'a>,
    /// Index of the next node.
    node: u32,
    /// Index of the next comment.
    comment: usize,
    next: Option<Token>,
}

impl<'a> Lexer<'a> {
    pub(super) fn new(tree: &'a Tree<'a>) -> Self {
        let mut lexer = Self { tree, node: 0, comment: 0, next: None };
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

    fn scan(&mut self, mut at: usize) -> Option<Token> {
        let text = self.tree.text();
        let mut breaks = 0;
        while let Some(byte) = text.as_bytes().get(at).filter(|byte| b" \t\r\n".contains(byte)) {
            breaks = if *byte == b'\n' { 2.min(breaks + 1) } else { breaks };
            at += 1;
        }
        let (kind, length) = match text.as_bytes().get(at)? {
            b',' => (Kind::Comma, 1),
            b':' => (Kind::Colon, 1),
            b'/' => {
                let comment = self.tree.comments().get(self.comment)?;
                let comment = &text[comment.0 as usize..comment.1 as usize];
                self.comment += 1;
                let kind = if comment.starts_with("//") { Kind::LineComment } else { Kind::BlockComment };
                (kind, comment.trim_ascii_end().len())
            }
            byte => {
                let kind = match byte {
                    b'{' | b'[' => Kind::Open,
                    b'}' | b']' => Kind::Close,
                    _ => Kind::Scalar,
                };
                let node = self.tree.node(self.node)?;
                self.node += 1;
                (kind, node.text().len())
            }
        };
        Some(Token { kind, range: at..at + length, breaks })
    }
}
