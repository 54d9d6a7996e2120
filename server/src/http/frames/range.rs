//! Ranges and entity tags of pictures (RFC 9110).

use std::ops::Range;

/// Bytes that a `Range` header requests.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::http) enum ByteRange {
    /// The full content: there is no range, or none that the server supports.
    Full,
    /// Requested bytes.
    Part(Range<u64>),
    /// The range is outside the content.
    Unsatisfiable,
}

/// Parses a `Range` header for content of `size_bytes`. For several ranges, the response is the full content.
pub(in crate::http) fn parse_range(header: Option<&str>, size_bytes: u64) -> ByteRange {
    let Some(spec) = header.and_then(|header| header.trim().strip_prefix("bytes=")) else { return ByteRange::Full };
    let Some((first, last)) = spec.split_once('-') else { return ByteRange::Full };
    let number = |text: &str| text.trim().parse::<u64>();
    let range = match (first.trim().is_empty(), last.trim().is_empty()) {
        (false, false) => match (number(first), number(last)) {
            (Ok(first), Ok(last)) if first <= last => first..last.saturating_add(1).min(size_bytes),
            _ => return ByteRange::Full,
        },
        (false, true) => match number(first) {
            Ok(first) => first..size_bytes,
            Err(_) => return ByteRange::Full,
        },
        (true, false) => match number(last) {
            Ok(count) => size_bytes.saturating_sub(count)..size_bytes,
            Err(_) => return ByteRange::Full,
        },
        (true, true) => return ByteRange::Full,
    };
    if range.start < range.end { ByteRange::Part(range) } else { ByteRange::Unsatisfiable }
}

/// Whether an `If-None-Match` header names this entity tag. The comparison is weak, as RFC 9110 requires for
/// this header.
pub(in crate::http) fn matches_etag(header: &str, tag: &str) -> bool {
    header.split(',').map(str::trim).any(|named| named == "*" || named.strip_prefix("W/").unwrap_or(named) == tag)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_parsed_according_to_rfc_9110() {
        for (header, wanted) in [
            ("bytes=0-9", ByteRange::Part(0..10)),
            ("bytes=90-", ByteRange::Part(90..100)),
            ("bytes=-10", ByteRange::Part(90..100)),
            ("bytes=-1000", ByteRange::Part(0..100)),
            ("bytes=50-1000", ByteRange::Part(50..100)),
            ("bytes=0-18446744073709551615", ByteRange::Part(0..100)),
            ("bytes=100-", ByteRange::Unsatisfiable),
            ("bytes=-0", ByteRange::Unsatisfiable),
            ("bytes=9-0", ByteRange::Full),
            ("bytes=0-1,5-6", ByteRange::Full),
            ("bytes=-", ByteRange::Full),
            ("lines=1-2", ByteRange::Full),
        ] {
            assert_eq!(parse_range(Some(header), 100), wanted, "{header}");
        }
        assert_eq!(parse_range(None, 100), ByteRange::Full);
    }

    #[test]
    fn entity_tags_are_compared_weakly() {
        assert!(matches_etag("\"a\", W/\"b\"", "\"b\""));
        assert!(matches_etag("*", "\"b\""));
        assert!(!matches_etag("\"a\"", "\"b\""));
    }
}
