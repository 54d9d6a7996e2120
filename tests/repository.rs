//! Tests the repository itself: file sizes, opening lines, required files; `words.rs` has forbidden words, `steps.rs`
//! the files of a new layer and flag.

mod steps;
mod words;

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
