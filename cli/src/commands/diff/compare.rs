//! Finds the differences of two JSON values: which were added, removed or changed.
//!
//! Entries of lists are matched: first those that are equal, then those between them that are most alike. So an entry
//! that is inserted is one difference.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use serde_json::{Map, Value};
use similar::{Algorithm, DiffTag, capture_diff_slices_deadline};

/// Time after which the matching of a list's equal entries becomes an approximation.
const MATCHING_TIME: Duration = Duration::from_secs(2);
/// Maximum number of pairs of entries that are compared for how alike they are; longer lists are matched in order.
const MAX_COMPARED_PAIRS: usize = 250_000;
/// Least share of equal leaves of two entries that are one entry, changed.
const MIN_ALIKE: f64 = 0.4;

/// A difference.
#[derive(Debug, PartialEq)]
pub(super) struct Difference<'a> {
    /// Path of the value in the later job; of a removed one in the earlier job.
    pub path: String,
    pub change: Change<'a>,
}

/// Kind of difference.
#[derive(Debug, PartialEq)]
pub(super) enum Change<'a> {
    Added(&'a Value),
    Removed(&'a Value),
    /// From one value to another.
    Changed(&'a Value, &'a Value),
}

/// The differences of two values, which nest less than the stack allows.
pub(super) fn differences<'a>(before: &'a Value, after: &'a Value) -> Vec<Difference<'a>> {
    let mut found = Vec::new();
    compare("", before, after, &mut found);
    found
}

fn compare<'a>(path: &str, before: &'a Value, after: &'a Value, found: &mut Vec<Difference<'a>>) {
    match (before, after) {
        (Value::Object(old), Value::Object(new)) if !is_other_kind(old, new) => {
            for (key, value) in old {
                let path = member(path, key);
                match new.get(key) {
                    Some(other) => compare(&path, value, other, found),
                    None => found.push(Difference { path, change: Change::Removed(value) }),
                }
            }
            for (key, value) in new.iter().filter(|(key, _)| !old.contains_key(*key)) {
                found.push(Difference { path: member(path, key), change: Change::Added(value) });
            }
        }
        (Value::Array(old), Value::Array(new)) => compare_lists(path, old, new, found),
        _ if is_equal(before, after) => {}
        _ => found.push(Difference { path: path.to_owned(), change: Change::Changed(before, after) }),
    }
}

/// Whether two objects have one key each, another one: a shape that became another shape.
fn is_other_kind(old: &Map<String, Value>, new: &Map<String, Value>) -> bool {
    old.len() == 1 && new.len() == 1 && old.keys().ne(new.keys())
}

/// Whether values are equal; 1 and 1.0 are.
fn is_equal(left: &Value, right: &Value) -> bool {
    match (left, right) {
        (Value::Number(left), Value::Number(right)) => left == right || left.as_f64() == right.as_f64(),
        _ => left == right,
    }
}

fn compare_lists<'a>(path: &str, old: &'a [Value], new: &'a [Value], found: &mut Vec<Difference<'a>>) {
    // A point that moved is three numbers that changed.
    if old.len() == new.len() && old.iter().chain(new).all(|value| !value.is_array() && !value.is_object()) {
        for (index, (old, new)) in old.iter().zip(new).enumerate() {
            compare(&format!("{path}[{index}]"), old, new, found);
        }
        return;
    }
    let (old_texts, new_texts): (Vec<String>, Vec<String>) =
        (old.iter().map(Value::to_string).collect(), new.iter().map(Value::to_string).collect());
    let deadline = Some(Instant::now() + MATCHING_TIME);
    for step in capture_diff_slices_deadline(Algorithm::Myers, &old_texts, &new_texts, deadline) {
        let (tag, olds, news) = step.as_tag_tuple();
        if tag == DiffTag::Equal {
            continue;
        }
        let (mut left, mut right) = (olds.start, news.start);
        for (old_index, new_index) in pairs(&old[olds.clone()], &new[news.clone()]) {
            let (old_index, new_index) = (olds.start + old_index, news.start + new_index);
            lone(path, old, left..old_index, Change::Removed, found);
            lone(path, new, right..new_index, Change::Added, found);
            compare(&format!("{path}[{new_index}]"), &old[old_index], &new[new_index], found);
            (left, right) = (old_index + 1, new_index + 1);
        }
        lone(path, old, left..olds.end, Change::Removed, found);
        lone(path, new, right..news.end, Change::Added, found);
    }
}

/// Reports entries that have no counterpart.
fn lone<'a>(
    path: &str,
    list: &'a [Value],
    range: std::ops::Range<usize>,
    change: fn(&'a Value) -> Change<'a>,
    found: &mut Vec<Difference<'a>>,
) {
    found.extend(range.map(|index| Difference { path: format!("{path}[{index}]"), change: change(&list[index]) }));
}

/// Pairs of entries of two lists that are most alike, in their order.
fn pairs(old: &[Value], new: &[Value]) -> Vec<(usize, usize)> {
    if (old.len() == 1 && new.len() == 1) || old.len() * new.len() > MAX_COMPARED_PAIRS {
        return (0..old.len().min(new.len())).map(|index| (index, index)).collect();
    }
    let (old, new): (Vec<_>, Vec<_>) = (old.iter().map(leaves).collect(), new.iter().map(leaves).collect());
    // The best sum of an alignment from each pair of positions on.
    let width = new.len() + 1;
    let mut best = vec![0.0_f64; (old.len() + 1) * width];
    let mut alike = vec![0.0_f64; best.len()];
    for left in (0..old.len()).rev() {
        for right in (0..new.len()).rev() {
            let here = left * width + right;
            alike[here] = share(&old[left], &new[right]);
            let skipped = best[here + 1].max(best[here + width]);
            best[here] =
                if alike[here] >= MIN_ALIKE { skipped.max(alike[here] + best[here + width + 1]) } else { skipped };
        }
    }
    let (mut left, mut right, mut pairs) = (0, 0, Vec::new());
    while left < old.len() && right < new.len() {
        let here = left * width + right;
        if alike[here] >= MIN_ALIKE && best[here] == alike[here] + best[here + width + 1] {
            pairs.push((left, right));
            (left, right) = (left + 1, right + 1);
        } else if best[here] == best[here + width] {
            left += 1;
        } else {
            right += 1;
        }
    }
    pairs
}

/// Share of the leaves that two values have in common.
fn share(left: &BTreeSet<String>, right: &BTreeSet<String>) -> f64 {
    let common = left.intersection(right).count();
    common as f64 / left.len().max(right.len()).max(1) as f64
}

/// The numbers and texts in a value, and its keys, each with its path.
fn leaves(value: &Value) -> BTreeSet<String> {
    fn collect(path: &str, value: &Value, leaves: &mut BTreeSet<String>) {
        match value {
            Value::Object(map) => {
                for (key, inside) in map {
                    let path = member(path, key);
                    collect(&path, inside, leaves);
                    leaves.insert(path);
                }
            }
            Value::Array(list) => {
                for (index, inside) in list.iter().enumerate() {
                    collect(&format!("{path}[{index}]"), inside, leaves);
                }
            }
            _ => {
                leaves.insert(format!("{path}={value}"));
            }
        }
    }
    let mut found = BTreeSet::new();
    collect("", value, &mut found);
    found
}

/// Path of a member of an object.
fn member(path: &str, key: &str) -> String {
    let is_plain = !key.is_empty() && key.chars().all(|letter| letter.is_alphanumeric() || "_-$".contains(letter));
    match (path, is_plain) {
        (_, false) => format!("{path}[{}]", Value::from(key)),
        ("", true) => key.to_owned(),
        (_, true) => format!("{path}.{key}"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::words::line;
    use super::*;

    fn lines(before: &str, after: &str) -> Vec<String> {
        let (before, after) = (serde_json::from_str(before).expect(before), serde_json::from_str(after).expect(after));
        differences(&before, &after).iter().map(line).collect()
    }

    #[test]
    fn differences_are_named_by_their_paths() {
        for (before, after, wanted) in [
            (r#"{"a": [0, 1], "b": 2}"#, r#"{"b": 2.0, "a": [0, 1.5]}"#, &["a[1]: 1 became 1.5"][..]),
            (r#"{"a b": 1, "c": 1}"#, r#"{"c": "x"}"#, &["[\"a b\"]: removed, was 1", "c: 1 became \"x\""]),
            (r#"{"m": {}}"#, r#"{"m": {"gold": {"flat": {"color": 1}}}}"#, &["m.gold: added (flat)"]),
            (r#"{"s": {"sphere": 1}}"#, r#"{"s": {"box": 1}}"#, &["s: {\"sphere\":1} became {\"box\":1}"]),
            (r"[[1, 2], [3]]", r"[[1, 2], [3]]", &[]),
        ] {
            assert_eq!(lines(before, after), wanted, "{before} {after}");
        }
    }

    #[test]
    fn inserted_and_removed_entries_are_one_difference_each() {
        let ball = |x: u32, radius: u32| {
            format!(
                r#"{{"shape": {{"translate": {{"by": [{x}, 0, 0], "child": {{"sphere": {{"radius": {radius}}}}}}}}}}}"#
            )
        };
        let list = |balls: &[String]| format!("[{}]", balls.join(","));
        let balls: Vec<String> = (0..50).map(|x| ball(x, 1)).collect();
        let mut more = balls.clone();
        more.insert(7, r#"{"material": "gold", "shape": {"box": {"size": [1, 1, 1]}}}"#.to_owned());
        assert_eq!(lines(&list(&balls), &list(&more)), ["[7]: added (gold box)"]);
        assert_eq!(lines(&list(&more), &list(&balls)), ["[7]: removed (gold box)"]);
        // One that changed beside one that is new.
        let mut both = more.clone();
        both[8] = ball(7, 3);
        assert_eq!(
            lines(&list(&balls), &list(&both)),
            ["[7]: added (gold box)", "[8].shape.translate.child.sphere.radius: 1 became 3"]
        );
    }
}
