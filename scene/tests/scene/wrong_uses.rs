//! Wrong uses of the job language, as authors make them: the files of `wrong_uses/` have each one with all its errors, their
//! places and their messages. `SDFARM_WRITE_ANSWERS=1` rewrites the errors.
//!
//! A case is a title, a line that says what is written, the text, and the errors. The text is a part of a job that is sound
//! otherwise: a `shape`, a `material`, a `light`, a `camera`, an `image`, members of the `scene` or of the whole job
//! (`members`), or a `job`. `set PATH VALUE` sets a value of the members that follow. An error has the line and the column in
//! the text, the JSON pointer, and what is at the place.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use scene::{ParseError, ValidationError, parse, set_value};

/// Minimum number of wrong uses.
const LEAST: usize = 200;
const WRITE: &str = "SDFARM_WRITE_ANSWERS";
/// Before an error.
const ERROR: &str = "-- ";

const CAMERA: &str = r#""camera": { "position": [0, 1, 5], "look_at": [0, 0, 0] }"#;
const IMAGE: &str = r#""image": { "width": 32, "height": 32 }"#;
const SPHERE: &str = r#"{ "sphere": { "radius": 1 } }"#;

/// Words with which a message says what to do instead.
const CURES: [&str; 26] = [
    "must ",
    "write ",
    "use ",
    "remove",
    "add ",
    "did you mean",
    "leave ",
    "choose ",
    "make ",
    "set ",
    "move ",
    "put ",
    "break ",
    "save ",
    "lower ",
    "needs ",
    "expected ",
    "up to ",
    "look ",
    "nest ",
    "give ",
    "keep ",
    "only ",
    "divide ",
    "enlarge ",
    "lacks its",
];

/// A wrong use.
struct Case<'t> {
    title: &'t str,
    /// The name of a part of a job.
    part: &'t str,
    text: &'t str,
}

impl<'t> Case<'t> {
    /// A case without its errors.
    fn new(text: &'t str) -> Self {
        let (title, rest) = text.split_once('\n').expect("a title");
        let (part, rest) = rest.split_once('\n').expect("the name of a part");
        let end = rest.find(&format!("\n{ERROR}")).unwrap_or(rest.trim_end().len());
        Self { title, part, text: &rest[..end] }
    }

    /// The job around the text: what is before it ends a line, except that nothing is before a whole job.
    fn job(&self) -> String {
        let text = self.text;
        let around = |before: &str, after: &str| format!("{before}\n{text}\n{after}");
        let has = |key: &str| text.contains(&format!("\"{key}\": "));
        let objects = format!(r#""objects": [{{ "shape": {SPHERE} }}]"#);
        match self.part.split(' ').next().unwrap_or_default() {
            "shape" => {
                around(&format!(r#"{{ "scene": {{ {CAMERA}, "objects": [{{ "shape":"#), &format!("}}] }}, {IMAGE} }}"))
            }
            "material" => around(
                &format!(r#"{{ "scene": {{ {CAMERA}, "objects": [{{ "shape": {SPHERE}, "material":"#),
                &format!("}}] }}, {IMAGE} }}"),
            ),
            "light" => {
                around(&format!(r#"{{ "scene": {{ {CAMERA}, {objects}, "lights": ["#), &format!("] }}, {IMAGE} }}"))
            }
            "camera" => around(r#"{ "scene": { "camera":"#, &format!(", {objects} }}, {IMAGE} }}")),
            "image" => around(&format!(r#"{{ "scene": {{ {CAMERA}, {objects} }}, "image":"#), "}"),
            "scene" => {
                let camera = if has("camera") { String::new() } else { format!("{CAMERA}, ") };
                let objects = if has("objects") { String::new() } else { format!(", {objects}") };
                around(&format!("{{ \"scene\": {{ {camera}"), &format!("{objects} }}, {IMAGE} }}"))
            }
            "members" | "set" => {
                let scene =
                    if has("scene") { String::new() } else { format!(r#""scene": {{ {CAMERA}, {objects} }}, "#) };
                let image = if has("image") { String::new() } else { format!(", {IMAGE}") };
                around(&format!("{{ {scene}"), &format!("{image} }}"))
            }
            "job" => text.to_owned(),
            other => panic!("{}: there is no part {other}", self.title),
        }
    }

    /// The errors: the message of each, and where it is.
    fn errors(&self) -> Vec<(String, String)> {
        let mut job = self.job();
        if let Some(set) = self.part.strip_prefix("set ") {
            let (path, value) = set.split_once(' ').expect("a path and a value");
            match set_value(&job, path, value) {
                Ok(text) => job = text,
                Err(message) => return vec![(format!("--set {path}"), message)],
            }
        }
        let errors = match parse(job.as_bytes()) {
            Ok(_) => Vec::new(),
            Err(ParseError::NotJson(error)) => vec![error],
            Err(ParseError::Invalid(errors)) => errors,
        };
        errors.into_iter().map(|error| (self.place(&job, &error), error.message)).collect()
    }

    /// The place of an error, and what is there.
    fn place(&self, job: &str, error: &ValidationError) -> String {
        let line = job.lines().nth(error.line as usize - 1).unwrap_or_default();
        let there: String = line.get(error.column as usize - 1..).unwrap_or_default().chars().take(20).collect();
        let before = u32::from(self.part != "job");
        assert!(error.line > 0 && error.column > 0, "{}: {error}", self.title);
        let place = format!("{}:{} {}", error.line - before, error.column, error.pointer);
        format!("{}, at {}", place.trim_end(), there.trim_end())
    }
}

fn files() -> Vec<(PathBuf, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/scene/wrong_uses");
    let entries =
        std::fs::read_dir(folder).expect("the folder of wrong uses").map(|entry| entry.expect("an entry").path());
    let mut files: Vec<_> =
        entries.map(|path| (path.clone(), std::fs::read_to_string(&path).expect("a text"))).collect();
    files.sort();
    files
}

#[test]
fn each_wrong_use_has_the_recorded_errors() {
    let (mut titles, mut reported, mut wrong) = (BTreeSet::new(), BTreeSet::new(), Vec::new());
    for (path, kept) in files() {
        let mut cases = kept.split("\n## ");
        let mut text = cases.next().unwrap_or_default().trim_end().to_owned();
        for case in cases.map(Case::new) {
            assert!(titles.insert(case.title.to_owned()), "the title {:?} occurs twice", case.title);
            let errors = case.errors();
            write!(text, "\n\n## {}\n{}\n{}", case.title, case.part, case.text).expect("writing to a string");
            if errors.is_empty() {
                wrong.push(format!("{}: is read without errors", case.title));
            }
            for (place, message) in errors {
                write!(text, "\n{ERROR}{place}\n   {message}").expect("writing to a string");
                if !CURES.iter().any(|cure| message.contains(cure)) {
                    wrong.push(format!("{}: {message} has no cure", case.title));
                }
                reported.insert(message);
            }
        }
        text.push('\n');
        if std::env::var_os(WRITE).is_some() {
            std::fs::write(&path, &text).expect("written");
        } else {
            for (want, got) in kept.split("\n## ").zip(text.split("\n## ")) {
                assert_eq!(got, want, "errors have changed: if that is intended, rewrite them with {WRITE}=1");
            }
            assert_eq!(kept, text, "rewrite the errors with {WRITE}=1");
        }
    }
    assert!(wrong.is_empty(), "{} wrong:\n{}", wrong.len(), wrong.join("\n"));
    assert!(
        titles.len() >= LEAST && reported.len() >= LEAST,
        "only {} cases, {} messages",
        titles.len(),
        reported.len()
    );
}
