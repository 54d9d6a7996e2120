//! Tests of formatting: examples, and comments at every place of generated texts.

use super::format;
use super::lexer::{Kind, Lexer};
use crate::json::Tree;

fn formatted(text: &str) -> String {
    format(text.as_bytes()).unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// Tokens of a text without trailing commas, and its comments without the spaces in them.
fn content(text: &str) -> (Vec<String>, Vec<String>) {
    let (mut tokens, mut comments) = (Vec::<String>::new(), Vec::new());
    let tree = Tree::read(text).unwrap_or_else(|error| panic!("{error:?}: {text}"));
    let mut lexer = Lexer::new(&tree);
    while let Some(token) = lexer.take() {
        let bytes = &text[token.range];
        match token.kind {
            Kind::LineComment | Kind::BlockComment => comments.push(bytes.split_ascii_whitespace().collect()),
            Kind::Close => {
                let _ = tokens.pop_if(|last| last == ",");
                tokens.push(bytes.to_owned());
            }
            Kind::Open | Kind::Comma | Kind::Colon | Kind::Scalar => tokens.push(bytes.to_owned()),
        }
    }
    (tokens, comments)
}

/// Asserts what holds for every text.
fn assert_kept(text: &str) {
    let once = formatted(text);
    assert_eq!(content(&once), content(text), "{text}\nbecomes\n{once}");
    assert_eq!(formatted(&once), once, "{text}\nbecomes\n{once}");
    assert!(once.ends_with('\n') && !once.contains(" \n") && !once.contains("\n\n\n"), "{text}\nbecomes\n{once}");
}

#[test]
fn short_values_share_a_line_and_long_ones_have_a_line_each() {
    let long = (0..40).map(|number| format!("{number}.50")).collect::<Vec<_>>().join(",");
    let filled = formatted(&format!("[[{long}]]"));
    assert_eq!(filled.lines().count(), 7, "{filled}");
    assert!(filled.lines().all(|line| line.len() <= 100), "{filled}");
    for (text, wanted) in [
        ("{}", "{}\n"),
        ("[ ]", "[]\n"),
        (" 7 ", "7\n"),
        (
            "{\"a\":[0,1 ,\n5,],\"b\":{\"sphere\":{\"radius\":1.0e0}}}",
            "{\n  \"a\": [0, 1, 5],\n  \"b\": { \"sphere\": { \"radius\": 1.0e0 } }\n}\n",
        ),
        ("{\"a\":\n\n1,\n\n\n\n\"b\":{}\n\n}", "{\n  \"a\": 1,\n\n  \"b\": {}\n}\n"),
        ("[\"// \\\" é\",-0.0]", "[\n  \"// \\\" é\", -0.0\n]\n"),
    ] {
        assert_eq!(formatted(text), wanted, "{text}");
        assert_kept(text);
    }
}

#[test]
fn comments_stay_where_they_belong() {
    for (text, wanted) in [
        ("// a\n{}// b\n// c", "// a\n{} // b\n// c\n"),
        (
            "{ // open\n\"a\": 1, // one\n\n// two\n\"b\": 2 }",
            "{ // open\n  \"a\": 1, // one\n\n  // two\n  \"b\": 2\n}\n",
        ),
        ("{\"a\":[1,/* two */2,3/* three */,]}", "{\n  \"a\": [1, /* two */ 2, 3 /* three */]\n}\n"),
        ("{\"a\" // key\n:/* value */1}", "{\n  // key\n  \"a\": /* value */ 1\n}\n"),
        ("{\"a\":{/* none */}}", "{\n  \"a\": { /* none */ }\n}\n"),
        ("{\"a\":[/* none */]}", "{\n  \"a\": [/* none */]\n}\n"),
        ("{\"a\": 1 // end\n,\"b\":2, /* last */}", "{\n  \"a\": 1, // end\n  \"b\": 2 /* last */\n}\n"),
        ("{\n      /* a\n       * b\n       */\n\"a\":1}", "{\n  /* a\n   * b\n   */\n  \"a\": 1\n}\n"),
        ("{\"a\":[1\n// none\n]}\r\n", "{\n  \"a\": [\n    1\n    // none\n  ]\n}\n"),
    ] {
        assert_eq!(formatted(text), wanted, "{text}");
        assert_kept(text);
    }
}

const COMMENTS: [&str; 9] = [
    "/* c */",
    " // c \r\n",
    "\n// c\n",
    "\n/* c */\n",
    "/* a\r\r\n\n   b */",
    "\n\n  /* a \n * b\n*/",
    "\n\n// c\n\n\n",
    "/**/ /* é */",
    "\n/* c */ // d\n",
];

#[test]
fn comments_are_kept_at_every_place() {
    let long = format!("{{ \"long\": \"{}\", \"b\": [[1, 2], [3]], }}", "x".repeat(95));
    for text in ["{ \"a\": [1, {}, ], \"b\": { \"c\": [] } }", long.as_str(), "[[1, 2], 3]"] {
        let mut gaps = vec![0];
        let tree = Tree::read(text).unwrap_or_else(|error| panic!("{error:?}"));
        let mut lexer = Lexer::new(&tree);
        gaps.extend(std::iter::from_fn(|| lexer.take()).map(|token| token.range.end));
        for (index, first) in gaps.iter().enumerate() {
            for second in &gaps[index..] {
                for one in COMMENTS {
                    for other in COMMENTS {
                        let (before, rest) = text.split_at(*second);
                        let (start, middle) = before.split_at(*first);
                        assert_kept(&format!("{start}{one}{middle}{other}{rest}"));
                    }
                }
            }
        }
    }
}

/// Multiplicative generator, enough to vary texts.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }

    fn space(&mut self, text: &mut String) {
        match self.below(12) {
            0 => text.push_str(COMMENTS[self.below(COMMENTS.len() as u64) as usize]),
            1 => text.push_str("\n\n\t"),
            2..4 => text.push('\n'),
            4..6 => text.push(' '),
            _ => {}
        }
    }

    fn value(&mut self, text: &mut String, depth: u64) {
        self.space(text);
        match self.below(if depth > 6 { 3 } else { 6 }) {
            0 => text.push_str("\"a \\\" // [ {, é\""),
            1 => text.push_str(["-1.50e+3", "true", "null", "0"][self.below(4) as usize]),
            2 => text.push_str(&"7".repeat(1 + self.below(30) as usize)),
            3 => self.entries(text, depth, "[]", |_, _| {}),
            _ => self.entries(text, depth, "{}", |random, text| {
                text.push_str("\"key\"");
                random.space(text);
                text.push(':');
            }),
        }
        self.space(text);
    }

    fn entries(&mut self, text: &mut String, depth: u64, brackets: &str, key: fn(&mut Self, &mut String)) {
        text.push_str(&brackets[..1]);
        let count = if self.below(9) == 0 { 30 } else { self.below(6) };
        for index in 0..count {
            self.space(text);
            key(self, text);
            self.value(text, depth + 1);
            let is_last = index + 1 == count;
            text.push_str(if is_last && self.below(2) == 0 { "" } else { "," });
        }
        self.space(text);
        text.push_str(&brackets[1..]);
    }
}

#[test]
fn generated_texts_keep_their_content() {
    for seed in 0..600 {
        let mut text = String::new();
        Random(seed).value(&mut text, 2);
        if text.len() < 100_000 {
            assert_kept(&text);
        }
    }
}

#[test]
fn text_that_is_not_json_is_an_error_at_its_position() {
    for (text, line, words) in [
        ("{\n\"a\": 1 \"b\": 2}", 2, "a comma is missing"),
        ("[1,, 2]", 1, "two commas"),
        ("[1, /* open ]", 1, ""),
        ("{} {}", 1, "one job"),
        ("", 1, "EOF"),
        ("{'a': 1}", 1, "single quotes"),
    ] {
        let error = format(text.as_bytes()).expect_err(text).to_string();
        assert!(error.contains(&format!("{line}:")) && error.contains(words), "{text}: {error}");
    }
    assert!(format(b"\"\xff\"").expect_err("bytes").to_string().contains("UTF-8"));
    let brackets = "[".repeat(200_000);
    for text in [brackets.clone(), format!("{{\"a\": 1, \"a\": {brackets}{}}}", "]".repeat(200_000))] {
        assert!(format(text.as_bytes()).expect_err("deep").to_string().contains("nests deeper"));
        assert!(crate::parse(text.as_bytes()).is_err());
    }
    let deepest = format!("{}{}", "[".repeat(256), "]".repeat(256));
    assert_kept(&deepest);
}

#[test]
fn what_would_be_too_large_for_a_job_is_refused_without_being_made() {
    let nested = |count: usize| {
        let members = (0..count).map(|key| format!("\"{key}\":0,")).collect::<Vec<_>>().concat();
        format!("{}{{{members}}}{}", "[".repeat(250), "]".repeat(250))
    };
    // Each of the lines is indented by 500 spaces.
    assert_kept(&nested(300));
    let error = format(nested(70_000).as_bytes()).expect_err("35 MB").to_string();
    assert!(error.contains("would be larger than 32 MiB when formatted"), "{error}");
}
