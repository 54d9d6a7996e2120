//! Tests of trees: what is read, where it is, and that a text is kept byte for byte.

use super::*;
use crate::limits::{MAX_JSON_DEPTH, MAX_KEY_BYTES};

fn read(text: &str) -> Tree<'_> {
    Tree::read(text).unwrap_or_else(|error| panic!("{error:?}: {text}"))
}

fn error(text: &str) -> Option<(usize, String, OutlineErrorKind)> {
    let outline = match Tree::read(text) {
        Ok(tree) => tree.outline,
        Err(error) => error.outline,
    };
    outline.error().cloned().map(|OutlineError { at, pointer, kind }| (at, pointer, kind))
}

/// The text of a tree, put together of its tokens, its comments, and what may be between them.
fn rebuilt(tree: &Tree<'_>) -> String {
    let tokens = (0..).map_while(|index| tree.node(index)).map(|value| (value.start(), value.text().to_owned()));
    let comments = tree
        .comments()
        .iter()
        .map(|comment| (comment.0 as usize, tree.text()[comment.0 as usize..comment.1 as usize].to_owned()));
    let mut parts: Vec<(usize, String)> = tokens.chain(comments).collect();
    parts.sort();
    let mut text = String::new();
    for (start, part) in parts {
        let between = &tree.text()[text.len()..start];
        assert!(between.bytes().all(|byte| b" \t\r\n,:".contains(&byte)), "{between:?} is between tokens");
        text += between;
        text += &part;
    }
    text += &tree.text()[text.len()..];
    text
}

/// Texts from a sequence of numbers, each with JSON and spaces or comments around every token.
fn generated(seed: u64, depth: u64) -> String {
    struct Text {
        state: u64,
        out: String,
    }
    impl Text {
        fn below(&mut self, limit: u64) -> u64 {
            self.state = self.state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.state >> 33) % limit
        }
        fn blank(&mut self) {
            let blanks = ["", "", "", " ", "\n", "\t\r\n", "/* { \" */", "// [ , é\n", "/**/"];
            let blank = blanks[self.below(blanks.len() as u64) as usize];
            self.out += blank;
        }
        fn token(&mut self, token: &str) {
            self.blank();
            self.out += token;
            self.blank();
        }
        fn value(&mut self, depth: u64) {
            const SCALARS: [&str; 10] =
                ["0", "-0.0", "12.5e-7", "1e400", "true", "false", "null", "\"\"", r#""\u00e9\"\\""#, "\"// é\""];
            match self.below(if depth == 0 { 1 } else { 3 }) {
                0 => {
                    let scalar = SCALARS[self.below(10) as usize];
                    self.token(scalar);
                }
                kind => {
                    self.token(if kind == 1 { "[" } else { "{" });
                    let count = self.below(5);
                    for index in 0..count {
                        if kind == 2 {
                            self.token(&format!("\"k{index}\""));
                            self.token(":");
                        }
                        self.value(depth - 1);
                        if index + 1 < count || self.below(3) == 0 {
                            self.token(",");
                        }
                    }
                    self.token(if kind == 1 { "]" } else { "}" });
                }
            }
        }
    }
    let mut text = Text { state: seed, out: String::new() };
    text.value(depth);
    text.out
}

#[test]
fn generated_texts_are_kept_and_mean_what_serde_reads() {
    for seed in 0..2_000 {
        let text = generated(seed, 5);
        let tree = read(&text);
        assert_eq!(rebuilt(&tree), text);
        let plain = crate::plain_json(&text).replace("1e400", "1e300");
        let changed = read(&plain);
        let ours: serde_json::Value = serde::Deserialize::deserialize(changed.root()).expect("JSON");
        assert_eq!(ours, serde_json::from_str::<serde_json::Value>(&plain).expect("JSON"), "{text}");
    }
}

#[test]
fn a_text_is_refused_wherever_serde_refuses_it() {
    for seed in 0..100 {
        let text = generated(seed, 3);
        for at in (0..text.len()).filter(|at| text.is_char_boundary(*at) && text.is_char_boundary(at + 1)) {
            for with in ["", ",", "}", "\"", "0", "x"] {
                let broken = format!("{}{with}{}", &text[..at], &text[at + 1..]);
                let plain = crate::plain_json(&broken);
                let is_json = serde_json::from_str::<serde::de::IgnoredAny>(&plain).is_ok();
                assert_eq!(Tree::read(&broken).is_ok(), is_json, "{broken}");
            }
        }
    }
}

#[test]
fn positions_and_pointers_lead_to_each_other() {
    for seed in 0..400 {
        let text = generated(seed, 5);
        let tree = read(&text);
        let mut places = vec![(String::new(), tree.root())];
        while let Some((pointer, value)) = places.pop() {
            assert_eq!(tree.value_at(&pointer).map(Value::index), Some(value.index()), "{pointer} of {text}");
            assert_eq!(tree.pointer_at(value.start()), pointer, "{text}");
            places.extend(value.members().map(|(key, inside)| (format!("{pointer}/{}", key.string()), inside)));
            places.extend(value.entries().enumerate().map(|(index, inside)| (format!("{pointer}/{index}"), inside)));
        }
    }
}

#[test]
fn finds_values_by_pointer() {
    let tree = read(r#"{"a": [1, {"b/c": 22}], "d": "x", "~": {"\u0041":"\\"}, "d2": {"1": 7}}"#);
    let text = |pointer| tree.value_at(pointer).map(Value::text);
    assert_eq!(text("/a/0"), Some("1"));
    assert_eq!(text("/a/1/b~1c"), Some("22"));
    assert_eq!(text("/d"), Some("\"x\""));
    assert_eq!(text("/~0/A"), Some("\"\\\\\""));
    assert_eq!(text("/d2/1"), Some("7"));
    assert_eq!(text("/a/2"), None);
    assert_eq!(text("/e"), None);
    assert_eq!(tree.value_at("").map(Value::start), Some(0));
    assert_eq!(tree.key_at("/a/1/b~1c").map(Value::text), Some("\"b/c\""));
    assert!(tree.key_at("/a/0").is_none(), "an entry of a list has no key");
}

#[test]
fn of_two_members_of_one_name_the_first_with_the_rest_is_found() {
    let tree = read(r#"{"a": 1, "a": {"b": 2}}"#);
    assert_eq!(tree.value_at("/a").map(Value::text), Some("1"));
    assert_eq!(tree.value_at("/a/b").map(Value::text), Some("2"));
}

#[test]
fn finds_values_after_one_that_nests_too_deep() {
    let deep = format!("{}\"]\"{}", "[".repeat(300), "]".repeat(300));
    let text = format!(r#"{{"a": {deep}, "b": {{"c": 1}}}}"#);
    let tree = read(&text);
    assert_eq!(tree.value_at("/b/c").map(Value::start), text.rfind('1'));
    // The first 256 arrays, the object and the values after it are kept.
    assert_eq!(tree.value_count(), 259);
}

#[test]
fn long_members_are_errors_of_their_object() {
    let text = format!(r#"{{"a": [{{"{}": 1}}]}}"#, "k".repeat(MAX_KEY_BYTES + 1));
    assert_eq!(error(&text), Some((8, "/a/0".to_owned(), OutlineErrorKind::LongMember(MAX_KEY_BYTES + 1))));
    assert_eq!(error(&text.replace("kk", "k")), None);
}

#[test]
fn finds_duplicate_members_with_escapes() {
    let duplicate = |key: &str| OutlineErrorKind::DuplicateMember(key.to_owned());
    let text = r#"{"a": {"b": 1, "\u0062": 2}}"#;
    assert_eq!(error(text), Some((15, "/a/b".to_owned(), duplicate("b"))));
    let many = (0..40).map(|key| format!("\"k{key}\": [{{}}], ")).collect::<Vec<_>>().concat();
    let text = format!("[0, {{{many}\"k7\": 1}}]");
    assert_eq!(error(&text), Some((text.rfind("\"k7").unwrap(), "/1/k7".to_owned(), duplicate("k7"))));
    // The first in the text, though the object of the second ends before.
    let text = r#"{"a": 1, "a": {"b": 1, "b": 2}}"#;
    assert_eq!(error(text), Some((9, "/a".to_owned(), duplicate("a"))));
}

#[test]
fn deep_nesting_is_found_without_recursion() {
    for text in ["[".repeat(100_000), format!("{}{}", "{\"a\":".repeat(5_000), "}".repeat(5_000))] {
        let (_, pointer, kind) = error(&text).unwrap();
        assert_eq!(kind, OutlineErrorKind::TooDeep);
        assert_eq!(pointer.matches('/').count(), MAX_JSON_DEPTH);
    }
    let nested = |depth: usize| format!("{}1{}", "[".repeat(depth), "]".repeat(depth));
    assert_eq!(error(&nested(MAX_JSON_DEPTH)), None);
    let (at, ..) = error(&nested(MAX_JSON_DEPTH + 1)).unwrap();
    assert_eq!(at, MAX_JSON_DEPTH + 1);
    // It comes before a member that is there twice.
    let text = format!(r#"{{"a": 1, "a": {}}}"#, nested(MAX_JSON_DEPTH + 1));
    assert_eq!(error(&text).unwrap().2, OutlineErrorKind::TooDeep);
}

#[test]
fn what_is_no_json_is_refused() {
    for text in [
        "",
        "{",
        "\"abc",
        "]]",
        "{]",
        "{\"a\\",
        "nul",
        "[1,,2]",
        "[,]",
        "[/* none */,]",
        "{,}",
        "{\"a\" 1}",
        "{\"a\":}",
        "{1: 2}",
        "[1 2]",
        "01",
        "-",
        "1.",
        ".5",
        "1e",
        "+1",
        "tru",
        "truex",
        "\"\\q\"",
        "\"\\u12\"",
        "\"\n\"",
        "\"\u{0}\"",
        "\u{0}",
        "1 2",
        "[1]/",
        "[1 /* open ]",
        "{\"a\": 1]",
        "1/*x*/2",
        "\u{feff}1",
    ] {
        assert!(Tree::read(text).is_err(), "{text:?}");
    }
    // Half of a surrogate pair is an error of its value, not of the syntax.
    let tree = read(r#"["\ud800"]"#);
    let error = <Vec<String> as serde::Deserialize>::deserialize(tree.root()).unwrap_err();
    assert!(error.to_string().contains("hex escape"), "{error}");
}

#[test]
fn a_built_tree_knows_what_its_values_stand_for() {
    let text = r#"{"a": {"expr": "1/2"}, "b": [1, {"c": 2}]}"#;
    let users = read(text);
    let root = users.root();
    let mut builder = Builder::new(&users);
    builder.open(root);
    for (key, value) in root.members() {
        builder.copy(key);
        if key.raw() == "a" { builder.json("{\"x\":[0.5]}", value.start()) } else { builder.copy(value) }
    }
    builder.close(root);
    let tree = builder.finish(7);
    let whole: serde_json::Value = serde::Deserialize::deserialize(tree.root()).unwrap();
    assert_eq!(whole.to_string(), r#"{"a":{"x":[0.5]},"b":[1,{"c":2}]}"#);
    let origin = |pointer| tree.origin(tree.value_at(pointer).unwrap().start());
    assert_eq!(origin("/a/x/0"), text.find("{\"expr").unwrap());
    assert_eq!(origin("/b/1/c"), text.rfind('2').unwrap());
    assert_eq!(tree.length(), 7);
}
