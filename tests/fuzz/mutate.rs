//! Mutates inputs: bits, bytes, pieces of other inputs, and tokens with a meaning in the formats.

/// Tokens that often cause errors in parsers.
const WORDS: [&[u8]; 28] = [
    b"0",
    b"-1",
    b"1e999",
    b"-0",
    b"null",
    b"true",
    b"{}",
    b"[]",
    b"\"\"",
    b"\\u0000",
    b"\\ud800",
    b"\xff",
    b"\0",
    b"{",
    b"[[",
    b"\"",
    b",",
    b":",
    b"4294967296",
    b"18446744073709551616",
    b"NaN",
    b"bytes=",
    b"-",
    b"%00",
    b"\xff\xff\xff\xff",
    b"\0\0\0\x80",
    b"\xef\xbb\xbf",
    b"1e-320",
];
/// Maximum number of changes to one input.
const CHANGES: u64 = 6;

/// Pseudorandom number generator; the same seed gives the same numbers.
pub(super) struct SeededRng(u64);

impl SeededRng {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    pub(super) fn below(&mut self, limit: usize) -> usize {
        // Marsaglia, "Xorshift RNGs", 2003.
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % limit.max(1) as u64) as usize
    }

    /// Returns an input of the corpus with a few changes.
    pub(super) fn spoil(&mut self, corpus: &[Vec<u8>], most_bytes: usize) -> Vec<u8> {
        let mut input = corpus[self.below(corpus.len())].clone();
        for _ in 0..=self.below(CHANGES as usize) {
            self.change(&mut input, corpus);
        }
        input.truncate(most_bytes);
        input
    }

    fn change(&mut self, input: &mut Vec<u8>, corpus: &[Vec<u8>]) {
        let place = self.below(input.len() + 1);
        let length = self.below(32).min(input.len() - place);
        match self.below(8) {
            0 if place < input.len() => input[place] ^= 1 << self.below(8),
            1 if place < input.len() => input[place] = self.below(256) as u8,
            2 => drop(input.drain(place..place + length)),
            3 => {
                let again = input[place..place + length].to_vec();
                input.splice(place..place, again);
            }
            4 => {
                let word = WORDS[self.below(WORDS.len())];
                input.splice(place..place + length.min(word.len()), word.iter().copied());
            }
            5 => {
                let word = WORDS[self.below(WORDS.len())];
                input.splice(place..place, word.iter().copied());
            }
            6 => {
                let other = &corpus[self.below(corpus.len())];
                let from = self.below(other.len() + 1);
                let piece = &other[from..(from + self.below(64)).min(other.len())];
                input.splice(place..place, piece.iter().copied());
            }
            _ => input.truncate(place),
        }
    }
}
