//! Reads a text into the nodes of a tree, without recursion.

use std::borrow::Cow;
use std::collections::HashSet;

use super::{KEY, Node};
use crate::json_text::escape;
use crate::limits::{MAX_JSON_DEPTH, MAX_KEY_BYTES};

/// Keys of formulas, of uses of shapes, and of counted copies; all but the last make a job one with formulas.
const LANGUAGE_KEYS: [&str; 5] = ["expr", "numbers", "with", "count", "use"];
/// Number of keys of an object that are compared one by one; more are hashed.
const MAX_COMPARED_KEYS: usize = 8;

/// The text is not JSON.
#[derive(Debug)]
pub(crate) struct SyntaxError {
    /// Earlier findings.
    pub outline: Outline,
}

/// First errors that a parser would not find or not survive.
#[derive(Debug, Default)]
pub(crate) struct Outline {
    first: Option<OutlineError>,
    too_deep: Option<OutlineError>,
}

/// An error that a parser would not find or not survive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct OutlineError {
    /// Byte offset of the value or the member name.
    pub at: usize,
    /// JSON pointer to the error.
    pub pointer: String,
    /// Kind of error.
    pub kind: OutlineErrorKind,
}

/// Kind of error of an outline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum OutlineErrorKind {
    /// Arrays and objects nest deeper than allowed.
    TooDeep,
    /// A member name has this many bytes, more than allowed.
    LongMember(usize),
    /// An object has this member twice.
    DuplicateMember(String),
}

impl Outline {
    /// The first error. A value that nests too deep comes before a member that is there twice.
    pub(crate) fn error(&self) -> Option<&OutlineError> {
        match &self.first {
            Some(OutlineError { kind: OutlineErrorKind::DuplicateMember(_), .. }) => {
                self.too_deep.as_ref().or(self.first.as_ref())
            }
            first => first.as_ref(),
        }
    }
}

/// An open list or object.
#[derive(Clone, Copy, Debug)]
struct Open {
    index: u32,
    keys: u32,
    has_escape: bool,
}

/// Reader of a text.
pub(super) struct Reader<'a> {
    text: &'a str,
    bytes: &'a [u8],
    at: usize,
    /// Offset of the text's start in the tree.
    base: u32,
    open: Vec<Open>,
    /// Closing brackets of what is open and nests too deep.
    deep: Vec<u8>,
    pub(super) nodes: Vec<Node>,
    pub(super) comments: Vec<(u32, u32)>,
    pub(super) language_keys: Vec<u32>,
    pub(super) has_formulas: bool,
    pub(super) outline: Outline,
}

/// The text is not JSON at the reader's position.
struct Stop;

impl<'a> Reader<'a> {
    /// Reads a text whose offsets begin at `base`.
    pub(super) fn read(text: &'a str, base: u32) -> Result<Self, SyntaxError> {
        let mut reader = Self {
            text,
            bytes: text.as_bytes(),
            at: 0,
            base,
            open: Vec::new(),
            deep: Vec::new(),
            nodes: Vec::with_capacity(text.len() / 8),
            comments: Vec::new(),
            language_keys: Vec::new(),
            has_formulas: false,
            outline: Outline::default(),
        };
        // The upper half of the offsets is for text that is made.
        let is_read = text.len() < KEY as usize && reader.whole().is_ok();
        if is_read { Ok(reader) } else { Err(SyntaxError { outline: reader.outline }) }
    }

    fn whole(&mut self) -> Result<(), Stop> {
        loop {
            self.blanks()?;
            if !self.value()? {
                continue;
            }
            loop {
                self.blanks()?;
                let Some(closing) = self.closing() else {
                    return if self.at == self.bytes.len() { Ok(()) } else { Err(Stop) };
                };
                let byte = self.byte();
                if byte == b',' {
                    self.at += 1;
                    self.blanks()?;
                    // A trailing comma.
                    if self.byte() != closing {
                        self.key(closing)?;
                        break;
                    }
                } else if byte != closing {
                    return Err(Stop);
                }
                self.close();
            }
        }
    }

    /// The byte here; 0 at the end, which is no token.
    fn byte(&self) -> u8 {
        if self.at < self.bytes.len() { self.bytes[self.at] } else { 0 }
    }

    /// The closing bracket of what is open.
    fn closing(&self) -> Option<u8> {
        let of_open = |open: &Open| if self.bytes[self.start_of(open)] == b'{' { b'}' } else { b']' };
        self.deep.last().copied().or_else(|| self.open.last().map(of_open))
    }

    fn start_of(&self, open: &Open) -> usize {
        (self.nodes[open.index as usize].start - self.base) as usize
    }

    /// Moves past white space and comments.
    fn blanks(&mut self) -> Result<(), Stop> {
        loop {
            while matches!(self.byte(), b' ' | b'\t' | b'\r' | b'\n') {
                self.at += 1;
            }
            if self.byte() != b'/' {
                return Ok(());
            }
            let rest = &self.text[self.at..];
            let length = match self.bytes.get(self.at + 1) {
                Some(b'/') => rest.find('\n').unwrap_or(rest.len()),
                Some(b'*') => rest[2..].find("*/").ok_or(Stop)? + 4,
                Some(_) | None => return Err(Stop),
            };
            self.comments.push((self.at as u32, (self.at + length) as u32));
            self.at += length;
        }
    }

    /// Whether what is read is kept: it does not nest too deep.
    fn is_kept(&self) -> bool {
        self.open.len() <= MAX_JSON_DEPTH
    }

    /// Reads a value, or the start of a list or an object. Returns whether the value ends here.
    fn value(&mut self) -> Result<bool, Stop> {
        if let Some(open) = self.open.last().filter(|_| !self.is_kept() && self.outline.too_deep.is_none()) {
            let index = open.index as usize;
            self.report(self.at, self.open.len() - 1, index, OutlineErrorKind::TooDeep);
        }
        let start = self.at;
        match self.byte() {
            opening @ (b'{' | b'[') => {
                let closing = if opening == b'{' { b'}' } else { b']' };
                if self.is_kept() {
                    self.open.push(Open { index: self.nodes.len() as u32, keys: 0, has_escape: false });
                    self.nodes.push(Node { start: self.base + start as u32, size: 0 });
                } else {
                    self.deep.push(closing);
                }
                self.at += 1;
                self.blanks()?;
                if self.byte() == closing {
                    self.close();
                    return Ok(true);
                }
                self.key(closing)?;
                return Ok(false);
            }
            b'"' => {
                self.string()?;
            }
            b't' => self.word("true")?,
            b'f' => self.word("false")?,
            b'n' => self.word("null")?,
            _ => self.number()?,
        }
        self.push(start, 0);
        Ok(true)
    }

    fn push(&mut self, start: usize, flag: u32) {
        if self.is_kept() {
            self.nodes.push(Node { start: self.base + start as u32, size: (self.at - start) as u32 | flag });
        }
    }

    /// Reads a key and its colon, if what is open is an object.
    fn key(&mut self, closing: u8) -> Result<(), Stop> {
        if closing == b']' {
            return Ok(());
        }
        if self.byte() != b'"' {
            return Err(Stop);
        }
        let start = self.at;
        let has_escape = self.string()?;
        if self.is_kept() {
            self.known_key(start, has_escape);
        }
        self.push(start, KEY);
        self.blanks()?;
        if self.byte() != b':' {
            return Err(Stop);
        }
        self.at += 1;
        self.blanks()
    }

    fn known_key(&mut self, start: usize, has_escape: bool) {
        let raw = &self.text[start + 1..self.at - 1];
        if let Some(place) = LANGUAGE_KEYS.iter().position(|key| *key == raw) {
            self.language_keys.push(self.nodes.len() as u32);
            self.has_formulas |= place + 1 < LANGUAGE_KEYS.len();
        }
        let Some(open) = self.open.last_mut() else { return };
        open.keys += 1;
        open.has_escape |= has_escape;
        if raw.len() > MAX_KEY_BYTES {
            let bytes = unescaped(&self.text[start..self.at]).len();
            if bytes > MAX_KEY_BYTES {
                let index = open.index as usize;
                self.report(start, self.open.len() - 1, index, OutlineErrorKind::LongMember(bytes));
            }
        }
    }

    /// Moves past a closing bracket.
    fn close(&mut self) {
        let start = self.at;
        self.at += 1;
        if self.deep.pop().is_some() {
            return;
        }
        if let Some(open) = self.open.last().copied().filter(|open| open.keys > 1) {
            self.duplicates(open);
        }
        let Some(open) = self.open.pop() else { return };
        self.nodes.push(Node { start: self.base + start as u32, size: 1 });
        self.nodes[open.index as usize].size = self.nodes.len() as u32 - open.index;
    }

    /// Notes an error in the first of the open lists and objects, at the value of a node.
    fn report(&mut self, at: usize, depth: usize, index: usize, kind: OutlineErrorKind) {
        let is_deep = kind == OutlineErrorKind::TooDeep;
        let is_first = self.outline.first.as_ref().is_none_or(|first| at < first.at);
        if !is_first && !is_deep {
            return;
        }
        let inside = self.open[..depth].iter().map(|open| open.index as usize);
        let indices: Vec<usize> = inside.chain([index]).collect();
        let pointer = indices.windows(2).map(|step| self.step(step[0], step[1])).collect();
        let error = OutlineError { at, pointer, kind };
        if is_deep {
            self.outline.too_deep = Some(error.clone());
        }
        if is_first {
            self.outline.first = Some(error);
        }
    }

    /// Step of a JSON pointer from a list or an object to a value in it: the indices of their nodes.
    fn step(&self, parent: usize, child: usize) -> String {
        let start = |node: &Node| (node.start - self.base) as usize;
        if self.bytes[start(&self.nodes[parent])] == b'{' {
            let key = &self.nodes[child - 1];
            let text = &self.text[start(key)..start(key) + (key.size & !KEY) as usize];
            return format!("/{}", escape(&unescaped(text)));
        }
        let (mut at, mut index) = (parent + 1, 0_usize);
        while at < child {
            at += self.span(at);
            index += 1;
        }
        format!("/{index}")
    }

    /// Number of nodes of the value of a node.
    fn span(&self, index: usize) -> usize {
        let Some(node) = self.nodes.get(index) else { return 1 };
        let is_open = matches!(self.bytes[(node.start - self.base) as usize], b'{' | b'[');
        if is_open { node.size as usize } else { 1 }
    }

    /// Finds the first key of an object that is there twice.
    fn duplicates(&mut self, open: Open) {
        let mut few: [&str; MAX_COMPARED_KEYS] = [""; MAX_COMPARED_KEYS];
        let mut many: HashSet<Cow<'_, str>> = HashSet::new();
        let is_small = open.keys as usize <= MAX_COMPARED_KEYS && !open.has_escape;
        let (mut at, mut count) = (open.index as usize + 1, 0);
        while let Some(key) = self.nodes.get(at) {
            let start = (key.start - self.base) as usize;
            let text = &self.text[start..start + (key.size & !KEY) as usize];
            let is_new = if is_small {
                let is_new = !few[..count].contains(&text);
                few[count] = text;
                count += 1;
                is_new
            } else {
                many.insert(unescaped(text))
            };
            if !is_new {
                let key = unescaped(text).into_owned();
                self.report(start, self.open.len(), at + 1, OutlineErrorKind::DuplicateMember(key));
                return;
            }
            at += 1;
            at += self.span(at);
        }
    }

    /// Moves past a string; returns whether it has escapes.
    fn string(&mut self) -> Result<bool, Stop> {
        let mut has_escape = false;
        self.at += 1;
        loop {
            match self.byte() {
                b'"' => {
                    self.at += 1;
                    return Ok(has_escape);
                }
                b'\\' => {
                    has_escape = true;
                    let escape = self.bytes.get(self.at + 1).ok_or(Stop)?;
                    let hex = self.bytes.get(self.at + 2..self.at + 6).unwrap_or_default();
                    self.at += match escape {
                        b'"' | b'\\' | b'/' | b'b' | b'f' | b'n' | b'r' | b't' => 2,
                        b'u' if hex.len() == 4 && hex.iter().all(u8::is_ascii_hexdigit) => 6,
                        _ => return Err(Stop),
                    };
                }
                // A control character, or the end of the text.
                0..0x20 => return Err(Stop),
                _ => self.at += 1,
            }
        }
    }

    fn word(&mut self, word: &str) -> Result<(), Stop> {
        if !self.bytes[self.at..].starts_with(word.as_bytes()) {
            return Err(Stop);
        }
        self.at += word.len();
        Ok(())
    }

    fn number(&mut self) -> Result<(), Stop> {
        self.at += usize::from(self.byte() == b'-');
        if self.byte() == b'0' {
            self.at += 1;
            if self.byte().is_ascii_digit() {
                return Err(Stop);
            }
        } else {
            self.digits()?;
        }
        if self.byte() == b'.' {
            self.at += 1;
            self.digits()?;
        }
        if matches!(self.byte(), b'e' | b'E') {
            self.at += 1;
            self.at += usize::from(matches!(self.byte(), b'+' | b'-'));
            self.digits()?;
        }
        Ok(())
    }

    fn digits(&mut self) -> Result<(), Stop> {
        let start = self.at;
        while self.byte().is_ascii_digit() {
            self.at += 1;
        }
        if self.at > start { Ok(()) } else { Err(Stop) }
    }
}

/// The meaning of a string; its text if it has half of a surrogate pair.
fn unescaped(string: &str) -> Cow<'_, str> {
    let raw = &string[1..string.len() - 1];
    if !raw.contains('\\') {
        return Cow::Borrowed(raw);
    }
    serde_json::from_str(string).map_or(Cow::Borrowed(raw), Cow::Owned)
}
