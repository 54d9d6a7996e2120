//! Tests the repository itself: file sizes, opening lines, required files, and forbidden words.

use std::path::{Path, PathBuf};
use std::{fs, io};

use crate::support::root;

const MAX_LINES: usize = 500;
const CODE: [&str; 8] = ["scene", "proto", "server", "worker", "cli", "web", "tests", "docs"];
/// Folder of files that others wrote, which are kept as they are.
const VENDORED: &str = "web/vendor";
/// Properties and functions that read text as markup or as a program. The page has none: names of jobs are text.
const MARKUP_SINKS: [&str; 13] = [
    "innerHTML",
    "outerHTML",
    "insertAdjacentHTML",
    "document.write",
    "setHTMLUnsafe",
    "parseHTMLUnsafe",
    "DOMParser",
    "createContextualFragment",
    "srcdoc",
    "eval(",
    "new Function",
    "javascript:",
    "style=",
];

/// Text in which a word is forbidden.
#[derive(Clone, Copy, Debug)]
enum Context {
    /// Any line of a file.
    Line,
    /// A comment line of Rust, SQL, or YAML.
    Comment,
    /// The first word of a comment line.
    CommentStart,
    /// The name of a Rust type.
    TypeName,
}

/// Forbidden words in lower case, separated by `|`, and the reason. A space is the start or the end of a word.
const WORDS: [(Context, &str, &str); 7] = [
    (
        Context::Line,
        "colour| centre| grey |neighbour|licence| matt |authoris|recognis|quantis|practise|spelt|towards",
        "the project uses American spelling",
    ),
    (Context::Comment, " whoever | nobody ", "name the actor: the client, the worker, no user"),
    (Context::Comment, " anew ", "write `again`"),
    (Context::Comment, " so many | so long | so often ", "give the number, or name the parameter"),
    (Context::CommentStart, " what | who | whom | whose ", "start with a noun phrase or a verb"),
    (
        Context::TypeName,
        " basket | bell | chance | clothes | crowd | deed | dice | doors | entrance | exemplary | leftovers | lettering ",
        "use a term of docs/glossary.md",
    ),
    (
        Context::TypeName,
        " moment | patience | pretender | relief | ring | sketch | sketches | still | stuff | tally | tint | told \
         | trouble | turned | wish | worn ",
        "use a term of docs/glossary.md",
    ),
];

/// All files in some folders with these extensions, with their text.
fn files(folders: &[&str], extensions: &[&str]) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    for folder in folders {
        let folder = root().join(folder);
        if folder.is_dir() {
            walk(&folder, extensions, &mut found).expect("the tree is readable");
        }
    }
    found
}

fn walk(folder: &Path, extensions: &[&str], found: &mut Vec<(PathBuf, String)>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.ends_with(VENDORED) {
            continue;
        }
        if path.is_dir() {
            walk(&path, extensions, found)?;
        } else if path.extension().is_some_and(|extension| extensions.iter().any(|known| extension == *known)) {
            let text = fs::read_to_string(&path)?;
            found.push((path.strip_prefix(root()).expect("under the root").to_owned(), text));
        }
    }
    Ok(())
}

fn assert_none(what: &str, bad: &[String]) {
    assert!(bad.is_empty(), "{what}:\n{}", bad.join("\n"));
}

#[test]
fn no_source_file_is_longer_than_five_hundred_lines() {
    let long = files(&CODE, &["rs", "cu", "js", "sql"])
        .into_iter()
        .filter(|(_, text)| text.lines().count() > MAX_LINES)
        .map(|(path, text)| format!("{}: {}", path.display(), text.lines().count()))
        .collect::<Vec<_>>();
    assert_none("too long", &long);
}

#[test]
fn every_source_file_opens_with_its_purpose() {
    let opens = |path: &Path, text: &str| {
        let marker = if path.extension().is_some_and(|extension| extension == "js") { "// " } else { "//! " };
        text.starts_with(marker) && text.lines().next().is_some_and(|line| line.len() >= 20)
    };
    let code = files(&CODE, &["rs"]).into_iter().chain(files(&["web"], &["js"]));
    let silent =
        code.filter(|(path, text)| !opens(path, text)).map(|(path, _)| path.display().to_string()).collect::<Vec<_>>();
    assert_none("no opening words", &silent);
}

#[test]
fn the_page_reads_no_text_as_markup() {
    let page = files(&["web"], &["js", "html", "svg"]);
    assert!(page.len() > 20, "the files of the page are missing");
    let mut found = Vec::new();
    for (path, text) in page {
        for (number, line) in text.lines().enumerate() {
            for sink in MARKUP_SINKS.iter().filter(|sink| line.contains(**sink)) {
                found.push(format!("{}:{}: {sink}", path.display(), number + 1));
            }
        }
    }
    assert_none("text would be read as markup or as a program", &found);
}

#[test]
fn no_unfinished_code_is_left() {
    // Assembled here, so that this file does not match.
    let marks = [concat!("TO", "DO"), concat!("FIX", "ME"), concat!("XX", "X")].map(str::to_owned);
    let macros = ["todo", "unimplemented", "dbg"].map(|name| format!("{name}!("));
    let mut left = Vec::new();
    for (path, text) in files(&CODE, &["rs", "cu", "sql", "toml", "md", "js", "css", "html"]) {
        for (number, line) in text.lines().enumerate() {
            if marks.iter().chain(&macros).any(|mark| line.contains(mark.as_str())) {
                left.push(format!("{}:{}: {line}", path.display(), number + 1));
            }
        }
    }
    assert_none("unfinished", &left);
}

#[test]
fn no_file_contains_a_path_of_a_users_machine() {
    let home = ["home", "root", "work", "Users"].map(|folder| format!("/{folder}/"));
    let mut found = Vec::new();
    let tree = [CODE.as_slice(), &["scenes", "migrations", "docker", ".ci"]].concat();
    for (path, text) in files(&tree, &["rs", "toml", "md", "json", "sql", "yml", "yaml"]) {
        for (number, line) in text.lines().enumerate() {
            if home.iter().any(|folder| line.contains(folder.as_str())) {
                found.push(format!("{}:{}: {line}", path.display(), number + 1));
            }
        }
    }
    assert_none("machine paths", &found);
}

#[test]
fn no_module_is_named_mod() {
    let named = files(&CODE, &["rs"])
        .into_iter()
        .filter(|(path, _)| path.ends_with("mod.rs"))
        .map(|(path, _)| path.display().to_string())
        .collect::<Vec<_>>();
    assert_none("foo.rs + foo/ instead", &named);
}

#[test]
fn required_files_exist() {
    for name in
        ["README.md", "ARCHITECTURE.md", "CHANGELOG.md", "LICENSE-MIT", "LICENSE-APACHE", "deny.toml", ".ci/run"]
    {
        assert!(root().join(name).is_file(), "{name} is missing");
    }
    let lines = |name: &str| fs::read_to_string(root().join(name)).expect("there").lines().count();
    assert!(lines("README.md") <= 150, "the README is for a first visit");
    assert!(lines("ARCHITECTURE.md") <= 200, "the architecture is for a first reading");
    assert!(lines("docs/benchmarks.md") <= 250, "tables only: experiments are in docs/notebook.md");
}

#[test]
fn no_script_stands_among_the_pages() {
    let scripts = files(&["docs"], &["py", "sh", "js", "rs"]);
    assert_none("belongs into tests/", &scripts.iter().map(|(path, _)| path.display().to_string()).collect::<Vec<_>>());
}

#[test]
fn changelog_has_an_unreleased_section() {
    let changelog = fs::read_to_string(root().join("CHANGELOG.md")).expect("there");
    assert!(changelog.contains("## Unreleased"));
}

/// Text of a comment line, without its marker.
fn comment<'a>(path: &Path, line: &'a str) -> Option<&'a str> {
    let marker = match path.extension()?.to_str()? {
        "rs" | "js" => "//",
        "sql" => "--",
        "yml" => "#",
        _ => return None,
    };
    Some(line.trim_start().strip_prefix(marker)?.trim_start_matches(['/', '!', ' ']))
}

/// Name of the type that a line of Rust declares.
fn type_name(line: &str) -> Option<&str> {
    let mut words = line.split(|letter: char| !letter.is_alphanumeric() && letter != '_');
    words.find(|word| ["struct", "enum", "trait", "type"].contains(word))?;
    words.next()
}

/// Lower-case words of a text, with a space before, between, and after them.
fn words(text: &str) -> String {
    let words = text.split(|letter: char| !letter.is_alphanumeric()).filter(|word| !word.is_empty());
    format!(" {} ", words.map(str::to_lowercase).collect::<Vec<_>>().join(" "))
}

/// Forbidden words of a line, each with its reason.
fn forbidden(path: &Path, line: &str) -> Vec<String> {
    // Tests of the parser's suggestions use the British word as a wrong key.
    let line = ["\"colour", "colour\"", "`colour`"].iter().fold(line.to_owned(), |line, key| line.replace(key, ""));
    let comment = comment(path, &line).map(words);
    let is_code = comment.is_none() && path.extension().is_some_and(|extension| extension == "rs");
    let type_name = if is_code { type_name(&line).map(words) } else { None };
    let line = words(&line);
    let mut found = Vec::new();
    for (context, list, reason) in WORDS {
        let is_found = |word: &&str| match context {
            Context::Line => line.contains(word),
            Context::Comment => comment.as_ref().is_some_and(|text| text.contains(word)),
            Context::CommentStart => comment.as_ref().is_some_and(|text| text.starts_with(word)),
            Context::TypeName => type_name.as_deref() == Some(*word),
        };
        found.extend(list.split('|').filter(is_found).map(|word| format!("{:?}: {reason}", word.trim())));
    }
    found
}

#[test]
fn no_forbidden_words_are_used() {
    let folders = [CODE.as_slice(), &["scenes", "docker", ".ci"]].concat();
    let mut texts = files(&folders, &["rs", "md", "sql", "yml"]);
    texts.extend(files(&["web"], &["js", "css", "html"]));
    for name in ["README.md", "ARCHITECTURE.md", "CHANGELOG.md"] {
        texts.push((name.into(), fs::read_to_string(root().join(name)).expect("the page exists")));
    }
    let mut found = Vec::new();
    for (path, text) in texts {
        // This file contains the list.
        if path == Path::new("tests/repository.rs") {
            continue;
        }
        for (number, line) in text.lines().enumerate() {
            let line_name = format!("{}:{}", path.display(), number + 1);
            found.extend(forbidden(&path, line).iter().map(|word| format!("{line_name}: {word}")));
        }
    }
    assert_none("forbidden words", &found);
}

#[test]
fn forbidden_words_are_found_where_they_are_forbidden() {
    let count = |path: &str, line: &str| forbidden(Path::new(path), line).len();
    for line in ["/// What a worker does.", "// Rendered anew.", "let grey = 1;", "pub struct Wish {", "// so  many"] {
        assert_eq!(count("a.rs", line), 1, "{line}");
    }
    for line in ["/// Whatever.", "let nobody = 1;", "say(\"colour\");", "struct Wishes;", "// a center, colors"] {
        assert_eq!(count("a.rs", line), 0, "{line}");
    }
    assert_eq!((count("a.md", "What is it? A colour."), count("a.sql", "-- Who waits")), (1, 1));
}
