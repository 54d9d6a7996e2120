//! Formats counts with their nouns: `1 frame`, `2 frames`. The command line prints every count this way.

/// Formats a count; the noun is given in the singular and takes an s (`delivery` becomes `deliveries`).
pub(crate) fn counted(number: impl Into<u64>, noun: &str) -> String {
    let number = number.into();
    match (number, noun.strip_suffix('y')) {
        (1, _) => format!("1 {noun}"),
        (_, Some(stem)) if !stem.ends_with(['a', 'e', 'o', 'u']) => format!("{number} {stem}ies"),
        _ => format!("{number} {noun}s"),
    }
}

/// Formats a `usize` count.
pub(crate) fn counted_len(number: usize, noun: &str) -> String {
    counted(number as u64, noun)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_thing_is_singular() {
        let cases = [
            (0, "frame", "0 frames"),
            (1, "frame", "1 frame"),
            (2, "frame", "2 frames"),
            (1, "delivery", "1 delivery"),
            (3, "delivery", "3 deliveries"),
            (2, "ray", "2 rays"),
        ];
        for (number, noun, text) in cases {
            assert_eq!(counted_len(number, noun), text);
        }
    }
}
