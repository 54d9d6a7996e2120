//! Where each part of a replaced text came from.

use super::scan;
use crate::error::{LineIndex, ValidationError};
use crate::json_scan::{locate_member, locate_value};

/// Where each part of a text came from in another one.
#[derive(Debug, Default)]
pub(super) struct Source(Vec<Piece>);

/// A part of the text, up to the next one.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// Byte offset where it begins.
    start: usize,
    /// Byte offset in the other text.
    from: usize,
    /// Whether it was copied; else all of it stands for what begins there.
    is_copy: bool,
}

impl Source {
    /// Notes that what follows from `start` is copied.
    pub(super) fn copied(&mut self, start: usize, from: usize) {
        self.0.push(Piece { start, from, is_copy: true });
    }

    /// Notes that what follows from `start` stands for something else.
    pub(super) fn replaced(&mut self, start: usize, from: usize) {
        self.0.push(Piece { start, from, is_copy: false });
    }

    /// Takes away what begins at `start` or later.
    pub(super) fn split_off(&mut self, start: usize) -> Self {
        Self(self.0.split_off(self.0.partition_point(|piece| piece.start < start)))
    }

    /// Adds what [`Source::split_off`] took away, moved by some bytes.
    pub(super) fn append(&mut self, rest: Self, by: usize) {
        self.0.extend(rest.0.into_iter().map(|piece| Piece { start: piece.start + by, ..piece }));
    }

    fn offset(&self, at: usize) -> usize {
        let next = self.0.partition_point(|piece| piece.start <= at);
        let piece = next.checked_sub(1).map(|index| self.0[index]);
        piece.map_or(0, |piece| if piece.is_copy { piece.from + (at - piece.start) } else { piece.from })
    }

    /// Pointer and byte offset in the user's text of what is at a pointer and an offset of the replaced one.
    pub(super) fn pointer(&self, text: &str, users: &str, pointer: &str, at: usize) -> (String, usize) {
        let offset = self.offset(at);
        let is_there = |found: Option<usize>| found == Some(offset);
        let is_same = is_there(locate_value(users, pointer)) || is_there(locate_member(users, pointer));
        let is_nowhere = at == 0 && locate_value(text, pointer).is_none();
        let pointer = if is_same || is_nowhere { pointer.to_owned() } else { scan::pointer_at(users, offset) };
        (pointer, offset)
    }

    /// Errors in the replaced text, at their positions in the user's.
    pub(super) fn place(&self, text: &str, users: &str, errors: Vec<ValidationError>) -> Vec<ValidationError> {
        let (lines, users_lines) = (LineIndex::new(text), LineIndex::new(users));
        let place = |error: ValidationError| {
            let at = lines.offset(error.line as usize, error.column as usize);
            let (pointer, offset) = self.pointer(text, users, &error.pointer, at);
            users_lines.fault(offset, pointer, error.message)
        };
        errors.into_iter().map(place).collect()
    }
}
