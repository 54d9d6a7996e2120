//! Comments and trailing commas, which people write into job files although JSON has none.

use std::borrow::Cow;

/// A job's text as JSON: comments (`// …` and `/* … */`) and trailing commas are replaced by as many spaces, so that every
/// other byte keeps its position. Text that is not JSON otherwise is left as it is.
pub fn plain_json(text: &str) -> Cow<'_, str> {
    let bytes = text.as_bytes();
    let mut blanks = Vec::new();
    // The last comma, if nothing but comments and space is after it, and whether a value is before it.
    let (mut comma, mut follows_value) = (None, false);
    let mut at = 0;
    while let Some(byte) = bytes.get(at) {
        match (byte, bytes.get(at + 1)) {
            (b'/', Some(b'/')) => {
                let length = bytes[at..].iter().position(|byte| *byte == b'\n').unwrap_or(bytes.len() - at);
                blanks.push(at..at + length);
                at += length;
                continue;
            }
            (b'/', Some(b'*')) => {
                let Some(length) = text[at + 2..].find("*/") else { break };
                blanks.push(at..at + length + 4);
                at += length + 4;
                continue;
            }
            (b'"', _) => {
                (comma, follows_value) = (None, true);
                at += 1;
                while let Some(byte) = bytes.get(at).filter(|byte| **byte != b'"') {
                    at += if *byte == b'\\' { 2 } else { 1 };
                }
            }
            (b',', _) => (comma, follows_value) = (follows_value.then_some(at), false),
            (b']' | b'}', _) => {
                blanks.extend(comma.take().map(|comma| comma..comma + 1));
                follows_value = true;
            }
            (b' ' | b'\t' | b'\r' | b'\n', _) => {}
            _ => (comma, follows_value) = (None, !matches!(byte, b'[' | b'{' | b':')),
        }
        at += 1;
    }
    if blanks.is_empty() {
        return Cow::Borrowed(text);
    }
    let mut plain = bytes.to_vec();
    for range in blanks {
        for byte in plain[range].iter_mut().filter(|byte| !matches!(byte, b'\n' | b'\r')) {
            *byte = b' ';
        }
    }
    String::from_utf8(plain).map_or(Cow::Borrowed(text), Cow::Owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_trailing_commas_become_spaces() {
        for (text, plain) in [
            ("{} // end", "{}       "),
            ("[1, /* é, */ 2,\n]", "[1,           2 \n]"),
            ("{\"a\": [1, 2 , // two\n ], }", "{\"a\": [1, 2         \n ]  }"),
            ("\"// no, ]\" ", "\"// no, ]\" "),
            ("\"\\\"// no\"", "\"\\\"// no\""),
            ("[1]", "[1]"),
            // Errors stay as they are.
            ("[,]", "[,]"),
            ("[/* none */,]", "[          ,]"),
            ("[1 // [\n,]", "[1     \n ]"),
            ("[1,,]", "[1,,]"),
            ("[1, /* open ]", "[1, /* open ]"),
        ] {
            assert_eq!(plain_json(text), plain, "{text}");
        }
        assert!(matches!(plain_json("[1, 2]"), Cow::Borrowed(_)));
    }
}
