//! Tests the words of the project: forbidden ones in texts, comments and identifiers.

use std::borrow::Cow;
use std::fs;
use std::path::{Path, PathBuf};

use super::{CODE, assert_none, files};
use crate::support::root;

/// Text in which a word is forbidden.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Context {
    /// Any line of a file.
    Line,
    /// A comment line of code, or a line of a page.
    Prose,
    /// A comment line of code.
    Comment,
    /// The first word of a comment line.
    CommentStart,
    /// A name in code below this folder: a type, a field, a variable, a function, a module.
    Identifier(&'static str),
}

/// Forbidden words in lower case, separated by `|`, and the reason. A space is the start or the end of a word.
const WORDS: [(Context, &str, &str); 10] = [
    (
        Context::Line,
        "colour| centre| grey |neighbour|licence| matt |authoris|recognis|quantis|practise|spelt|towards",
        "the project uses American spelling",
    ),
    (Context::Prose, " of which | those of ", "write the subject first: `its size`, `the job's tiles`"),
    (Context::Comment, " whoever | nobody ", "name the actor: the client, the worker, no user"),
    (Context::Comment, " anew ", "write `again`"),
    (Context::Comment, " so many | so long | so often ", "give the number, or name the parameter"),
    (Context::Comment, " told | wish | wishes | patience ", "name the message: reported, sent, requested, time limit"),
    (Context::CommentStart, " what | who | whom | whose ", "start with a noun phrase or a verb"),
    (
        Context::Identifier(""),
        " basket | bell | chance | clothes | crowd | deed | dice | doors | entrance | exemplary | leftover | lettering \
         | moment | patience | pretender | relief | sketch | still | stuff | tally | tint | told | trouble | turned \
         | wish | worn ",
        "use a term of docs/glossary.md",
    ),
    (Context::Identifier("server/"), " ring ", "use `wake`: a ring is a list of placements, or a library"),
    (Context::Identifier(""), " aov | relocate ", "use the name of the API: layer, move"),
];

/// Names of a kind in job files.
const KEPT: [&str; 2] = ["MandelbrotRelief", "mandelbrot_relief"];
/// The library of that name.
const RING: [&str; 2] = ["crypto::ring", "ring::"];
/// Words of a name from which on it is a sentence, as those of tests are.
const SENTENCE_WORDS: usize = 4;

/// Text of a comment line, without its marker.
fn comment<'a>(path: &Path, line: &'a str) -> Option<&'a str> {
    let markers: &[&str] = match path.extension()?.to_str()? {
        "rs" | "cu" | "cpp" => &["//"],
        "js" | "mjs" => &["//", "/**", "* "],
        "sql" => &["--"],
        "yml" | "yaml" | "py" | "toml" => &["#"],
        _ => return None,
    };
    let line = line.trim_start();
    Some(markers.iter().find_map(|marker| line.strip_prefix(marker))?.trim_start_matches(['/', '!', '*', ' ']))
}

/// Code without comments and texts, which become one space a line, so that lines stay.
fn bare_code(text: &str, is_script: bool) -> String {
    let mut code = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(start) = rest.find(['/', 'r', '"', '\'', '`']) {
        code += &rest[..start];
        rest = &rest[start..];
        if let Some(hidden) = hidden_bytes(rest, is_script) {
            code.push(' ');
            code.extend(rest[..hidden].chars().filter(|letter| *letter == '\n'));
            rest = &rest[hidden..];
        } else {
            code += &rest[..1];
            rest = &rest[1..];
        }
    }
    code + rest
}

/// Length of the comment or text that `rest` starts with.
fn hidden_bytes(rest: &str, is_script: bool) -> Option<usize> {
    let end_of = |start: usize, end: &str| rest[start..].find(end).map_or(rest.len(), |at| start + at + end.len());
    if rest.starts_with("//") {
        return Some(rest.find('\n').unwrap_or(rest.len()));
    }
    if rest.starts_with("/*") {
        return Some(end_of(2, "*/"));
    }
    if let Some(raw) = rest.strip_prefix('r').filter(|_| !is_script) {
        let hashes = raw.len() - raw.trim_start_matches('#').len();
        if raw[hashes..].starts_with('"') {
            return Some(end_of(hashes + 2, &format!("\"{}", "#".repeat(hashes))));
        }
    }
    match rest.chars().next()? {
        quote @ ('"' | '\'' | '`') if is_script => end_of_text(rest, quote, quote == '`'),
        '"' => end_of_text(rest, '"', true),
        // A letter; everything else after an apostrophe is a lifetime.
        '\'' if rest.starts_with("'\\") => Some(end_of(3, "'")),
        '\'' if rest.chars().nth(2) == Some('\'') => end_of_text(rest, '\'', false),
        _ => None,
    }
}

/// End of a text between quotes, with escapes; `None` if it has none in its line and may not go on.
fn end_of_text(rest: &str, quote: char, has_lines: bool) -> Option<usize> {
    let mut letters = rest.char_indices().skip(1);
    while let Some((at, letter)) = letters.next() {
        match letter {
            '\\' => drop(letters.next()),
            '\n' if !has_lines => return None,
            _ if letter == quote => return Some(at + 1),
            _ => {}
        }
    }
    None
}

/// Names in a line of bare code.
fn names(line: &str) -> impl Iterator<Item = &str> {
    line.split(|letter: char| !letter.is_alphanumeric() && letter != '_')
        .filter(|name| name.starts_with(|first: char| first.is_alphabetic() || first == '_'))
}

/// Lower-case words of a name, in snake case or in camel case.
fn words_of_name(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    for letter in name.chars() {
        let is_lower = words.last().and_then(|word| word.chars().last()).is_some_and(char::is_lowercase);
        if letter == '_' || (letter.is_uppercase() && is_lower) {
            words.push(String::new());
        }
        words.last_mut().expect("never empty").extend(letter.to_lowercase().filter(|letter| *letter != '_'));
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Lower-case words of a text, with a space before, between, and after them.
fn words(text: &str) -> String {
    let words = text.split(|letter: char| !letter.is_alphanumeric()).filter(|word| !word.is_empty());
    format!(" {} ", words.map(str::to_lowercase).collect::<Vec<_>>().join(" "))
}

/// Words of the names in a line of bare code, each with and without an `s` at its end.
fn words_of_names(code: &str) -> String {
    let mut all = " ".to_owned();
    for name in names(code).filter(|name| !KEPT.contains(name)) {
        let parts = words_of_name(name);
        if parts.len() < SENTENCE_WORDS {
            for part in parts.iter().flat_map(|part| [part, part.strip_suffix('s').unwrap_or(part)]) {
                all.extend([part, " "]);
            }
        }
    }
    all
}

/// A line without some parts.
fn without<'a>(line: &'a str, parts: &[&str]) -> Cow<'a, str> {
    parts.iter().fold(
        Cow::Borrowed(line),
        |line, part| {
            if line.contains(part) { Cow::Owned(line.replace(part, "")) } else { line }
        },
    )
}

/// Forbidden words of a line and of its bare code, each with its reason.
fn forbidden(path: &Path, line: &str, code: &str) -> Vec<String> {
    // Tests of the parser's suggestions use the British word as a wrong key.
    let line = without(line, &["\"colour", "colour\"", "`colour`"]);
    let comment = comment(path, &line).map(words);
    let is_page = path.extension().is_some_and(|extension| extension == "md");
    let code = words_of_names(&without(code, &RING));
    let line = words(&line);
    let prose = if is_page { Some(&line) } else { comment.as_ref() };
    let mut found = Vec::new();
    for (context, list, reason) in WORDS {
        let is_found = |word: &&str| match context {
            Context::Line => line.contains(word),
            Context::Prose => prose.is_some_and(|text| text.contains(word)),
            Context::Comment => comment.as_ref().is_some_and(|text| text.contains(word)),
            Context::CommentStart => comment.as_ref().is_some_and(|text| text.starts_with(word)),
            Context::Identifier(folder) => path.starts_with(folder) && code.contains(word),
        };
        found.extend(list.split('|').filter(is_found).map(|word| format!("{:?}: {reason}", word.trim())));
    }
    found
}

/// Code of a file line by line; empty lines if it is no code.
fn code_lines(path: &Path, text: &str) -> Vec<String> {
    let code = match path.extension().and_then(|extension| extension.to_str()) {
        Some("rs" | "cu" | "cpp") => bare_code(text, false),
        Some("js" | "mjs") => bare_code(text, true),
        _ => "\n".repeat(text.lines().count()),
    };
    code.lines().map(str::to_owned).collect()
}

/// All texts of the project in which words are tested.
fn texts() -> Vec<(PathBuf, String)> {
    let folders = [CODE.as_slice(), &["scenes", "docker", ".ci"]].concat();
    let mut texts = files(&folders, &["rs", "md", "sql", "yml", "yaml", "cu", "cpp", "js", "mjs", "py", "css", "html"]);
    for name in ["README.md", "ARCHITECTURE.md", "CHANGELOG.md"] {
        texts.push((name.into(), fs::read_to_string(root().join(name)).expect("the page exists")));
    }
    // This file contains the list; packages of others are installed below the tests.
    texts.retain(|(path, _)| {
        path != Path::new("tests/repository/words.rs")
            && !path.components().any(|part| part.as_os_str() == "node_modules")
    });
    texts
}

#[test]
fn no_forbidden_words_are_used() {
    let mut found = Vec::new();
    for (path, text) in texts() {
        for ((number, line), code) in text.lines().enumerate().zip(code_lines(&path, &text)) {
            let line_name = format!("{}:{}", path.display(), number + 1);
            found.extend(forbidden(&path, line, &code).iter().map(|word| format!("{line_name}: {word}")));
        }
    }
    assert_none("forbidden words", &found);
}

#[test]
fn forbidden_words_are_found_where_they_are_forbidden() {
    let count = |path: &str, line: &str| {
        let code = code_lines(Path::new(path), line);
        forbidden(Path::new(path), line, code.first().map_or("", String::as_str)).len()
    };
    for line in ["/// What a worker does.", "// Rendered anew.", "let grey = 1;", "pub struct Wish {", "// so  many"] {
        assert_eq!(count("a.rs", line), 1, "{line}");
    }
    for line in
        ["self.crowd", "let (a, is_told) = b;", "fn bells() {}", "// The size of which is 1.", "Some(TintVisitor)"]
    {
        assert_eq!(count("a.rs", line), 1, "{line}");
    }
    for line in ["/// Whatever.", "let nobody = 1;", "say(\"colour\");", "struct Wishing;", "// a center, colors"] {
        assert_eq!(count("a.rs", line), 0, "{line}");
    }
    for line in
        ["f::<'a, 'b>(\"told\") // It is still running.", "fn a_client_is_told_once() {}", "'\\'', r#\"told\"#", "ring"]
    {
        assert_eq!(count("a.rs", line), 0, "{line}");
    }
    assert_eq!((count("a.md", "What is it? A colour."), count("a.sql", "-- Who waits")), (1, 1));
    assert_eq!(
        (
            count("web/a.js", "#told = 'told';"),
            count("server/a.rs", "ring.add(ring::sign)"),
            count("a.md", "Those of a job")
        ),
        (1, 1, 1)
    );
}
