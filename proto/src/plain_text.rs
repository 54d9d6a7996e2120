//! Text from outside, made safe for terminals and text logs: control characters are shown as escapes.
//!
//! Names and messages come from users, workers and other servers. A terminal would execute an escape sequence in them,
//! a new line could forge a line of a log, and a bidirectional control could reorder what is around it.

use std::borrow::Cow;

/// Text on one line: every control character is shown as an escape, such as `\u{1b}` or `\n`.
pub fn escape_line(text: &str) -> Cow<'_, str> {
    escape(text, is_unsafe)
}

/// Text on any number of lines: like [`escape_line`], but line ends and tabs stay.
pub fn escape_lines(text: &str) -> Cow<'_, str> {
    escape(text, |character| is_unsafe(character) && !['\n', '\t'].contains(&character))
}

/// Whether a character controls a terminal, ends a line, or changes the direction or the visibility of others.
fn is_unsafe(character: char) -> bool {
    character.is_control()
        || matches!(
            character,
            '\u{61c}' | '\u{200b}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}'
                | '\u{feff}' | '\u{e0000}'..='\u{e007f}'
        )
}

fn escape(text: &str, is_escaped: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_escaped) {
        return Cow::Borrowed(text);
    }
    let mut plain = String::with_capacity(text.len() + 16);
    for character in text.chars() {
        match character {
            _ if !is_escaped(character) => plain.push(character),
            '\n' | '\r' | '\t' => plain.extend(character.escape_default()),
            _ => plain.extend(character.escape_unicode()),
        }
    }
    Cow::Owned(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_text_is_unchanged() {
        for text in ["", "fjord", "naïve ü 模型 👩\u{200d}🚀", "C:\\new \"quoted\""] {
            assert!(matches!(escape_line(text), Cow::Borrowed(same) if same == text), "{text}");
        }
    }

    #[test]
    fn control_characters_are_shown_as_escapes() {
        for (text, escaped) in [
            ("\u{1b}[2Jx", "\\u{1b}[2Jx"),
            ("\u{1b}]0;title\u{7}", "\\u{1b}]0;title\\u{7}"),
            ("a\nb\r\tc", "a\\nb\\r\\tc"),
            ("\u{9b}1m\u{7f}\u{0}", "\\u{9b}1m\\u{7f}\\u{0}"),
            ("a\u{202e}b\u{2066}c\u{2028}d", "a\\u{202e}b\\u{2066}c\\u{2028}d"),
            ("\u{feff}\u{200b}\u{200f}", "\\u{feff}\\u{200b}\\u{200f}"),
        ] {
            assert_eq!(escape_line(text), escaped);
        }
        assert_eq!(escape_lines("{\n\t\"a\": \"\u{1b}\"\r\n}"), "{\n\t\"a\": \"\\u{1b}\"\\r\n}");
    }
}
