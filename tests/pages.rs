//! Tests the project's pages: every table is complete, and every link has a target.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::support::root;

/// Folders without pages of the project.
const SKIPPED: [&str; 2] = ["target", "sdfarm-data"];

/// All pages, with their paths from the root.
fn pages() -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    let mut folders = vec![root().to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("the tree is readable").flatten() {
            let (path, name) = (entry.path(), entry.file_name().to_string_lossy().into_owned());
            if path.is_dir() && !name.starts_with('.') && !SKIPPED.contains(&&*name) {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                let text = fs::read_to_string(&path).expect("a page is text");
                found.push((path.strip_prefix(root()).expect("under the root").to_owned(), text));
            }
        }
    }
    assert!(found.len() > 10, "{found:?}");
    found
}

/// Lines of a page outside code blocks, with their numbers.
fn prose(page: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut is_code = false;
    page.lines().enumerate().filter_map(move |(index, line)| {
        if line.trim_start().starts_with("```") {
            is_code = !is_code;
            return None;
        }
        (!is_code).then_some((index + 1, line))
    })
}

/// Cells of a row. A pipe that is not a border is written `\|`, also in code.
fn cells(row: &str) -> usize {
    row.trim().replace("\\|", "").matches('|').count().saturating_sub(1)
}

/// Errors in the tables of a page.
fn faults_of_tables(page: &str) -> Vec<String> {
    let mut faults = Vec::new();
    let mut header: Option<(usize, usize)> = None;
    for (number, line) in prose(page) {
        if !line.starts_with('|') {
            header = None;
            continue;
        }
        if !line.trim_end().ends_with('|') {
            faults.push(format!("{number}: the row goes on in another line"));
        }
        let Some((begin, wanted)) = header else {
            header = Some((number, cells(line)));
            continue;
        };
        if cells(line) != wanted {
            faults.push(format!("{number}: {} cells, the header has {wanted}", cells(line)));
        }
        if number == begin + 1 && !line.chars().all(|letter| "|-: ".contains(letter)) {
            faults.push(format!("{number}: no line of dashes under the header"));
        }
    }
    faults
}

/// Targets of a page's links and pictures, except those on other hosts.
fn links(page: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (number, line) in prose(page) {
        for rest in line.split("](").skip(1) {
            let target = rest.split([')', ' ']).next().unwrap_or_default();
            if !target.contains("://") && !target.starts_with("mailto:") {
                found.push((number, target.to_owned()));
            }
        }
    }
    found
}

/// Anchors of a page's headings.
fn anchors(page: &str) -> BTreeSet<String> {
    prose(page)
        .filter_map(|(_, line)| line.strip_prefix('#'))
        .map(|line| line.trim_start_matches('#').trim().to_lowercase())
        .map(|heading| {
            let kept = heading.chars().filter(|letter| letter.is_alphanumeric() || " -_".contains(*letter));
            kept.map(|letter| if letter == ' ' { '-' } else { letter }).collect()
        })
        .collect()
}

#[test]
fn every_table_row_has_as_many_cells_as_its_header() {
    let faults: Vec<String> = pages()
        .into_iter()
        .flat_map(|(path, page)| {
            faults_of_tables(&page).into_iter().map(move |fault| format!("{}:{fault}", path.display()))
        })
        .collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn every_link_within_the_project_has_a_target() {
    let mut lost = Vec::new();
    for (path, page) in pages() {
        let folder = path.parent().unwrap_or(Path::new(""));
        for (number, target) in links(&page) {
            let (file, anchor) = target.split_once('#').unwrap_or((&target, ""));
            let linked = if file.is_empty() { root().join(&path) } else { root().join(folder).join(file) };
            let has_anchor = || fs::read_to_string(&linked).is_ok_and(|page| anchors(&page).contains(anchor));
            if !linked.exists() || (!anchor.is_empty() && !has_anchor()) {
                lost.push(format!("{}:{number}: {target}", path.display()));
            }
        }
    }
    assert!(lost.is_empty(), "links without a target:\n{}", lost.join("\n"));
}

#[test]
fn pictures_of_pages_are_small_and_each_is_on_a_page() {
    /// README's, which are as large as it shows them.
    const LARGE: [&str; 3] =
        ["docs/pictures/fjord.png", "docs/pictures/page/jobs.jpg", "docs/pictures/page/studio-light.jpg"];
    const MAX_BYTES: u64 = 25 << 10;
    let linked = |(path, page): (PathBuf, String)| -> Vec<PathBuf> {
        let folder = root().join(path.parent().unwrap_or(Path::new("")));
        links(&page).into_iter().filter_map(|(_, target)| fs::canonicalize(folder.join(target)).ok()).collect()
    };
    let linked: BTreeSet<PathBuf> = pages().into_iter().flat_map(linked).collect();
    let mut folders = vec![root().join("docs/pictures")];
    let (mut count, mut faults) = (0, Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("the tree is readable").flatten() {
            let path = entry.path();
            let name = path.strip_prefix(root()).expect("under the root").display().to_string();
            if path.is_dir() {
                folders.push(path);
            } else if name != "docs/pictures/hashes.txt" {
                count += 1;
                let bytes = entry.metadata().expect("a file has a size").len();
                if bytes > MAX_BYTES && !LARGE.contains(&&*name) {
                    faults.push(format!("{name} has {bytes} bytes"));
                }
                if !linked.contains(&fs::canonicalize(&path).expect("it is there")) {
                    faults.push(format!("{name} is on no page"));
                }
            }
        }
    }
    assert!(count > 350 && faults.is_empty(), "{count} pictures: {faults:#?}");
}

#[test]
fn broken_tables_and_links_are_found() {
    let table = "| a | b |\n|---|---|\n| 1 | 2 |\n| 1 |\n| 1 | 2\n3 |\n\n```text\n| x |\n| y | z |\n```\n| `p\\|q` | 2 |\n|---|---|\n";
    let faults = faults_of_tables(table);
    assert_eq!(faults.len(), 3, "{faults:?}");
    assert!(faults[0].starts_with("4: 1 cells") && faults[1].starts_with("5: the row goes on"), "{faults:?}");
    assert_eq!(faults_of_tables("| a |\n| b |\n"), ["2: no line of dashes under the header"]);
    assert_eq!(links("[a](b.md#c) ![d](e.png \"t\") <https://x>, [y](https://y.example)\n").len(), 2);
    assert!(anchors("## When it does not start\n### `a` & b\n").contains("when-it-does-not-start"));
}

#[test]
fn operations_page_lists_exactly_the_flags_of_serve() {
    let page = fs::read_to_string(root().join("docs/operations.md")).expect("there");
    let help = crate::support::succeed(&["serve", "--help"]);
    let rows = page.lines().skip_while(|line| !line.starts_with("| `serve` |"));
    let table = rows.take_while(|line| line.starts_with('|')).collect::<Vec<_>>().join("\n");
    let flags = |text: &str| -> BTreeSet<String> {
        let words = text.split(|letter: char| !letter.is_ascii_lowercase() && letter != '-');
        words.filter(|word| word.starts_with("--") && word.len() > 3).map(str::to_owned).collect()
    };
    let first = |text: &str| -> BTreeSet<String> {
        text.lines().filter_map(|line| line.split('|').nth(1)).flat_map(flags).collect()
    };
    let options: BTreeSet<String> = help
        .lines()
        .map(str::trim_start)
        .filter(|line| line.starts_with('-'))
        .flat_map(|line| flags(line.split("  ").next().unwrap_or_default()))
        .filter(|flag| !["--help", "--log", "--verbose", "--otlp", "--cache", "--block"].contains(&flag.as_str()))
        .collect();
    assert_eq!(first(&table), options, "the table of docs/operations.md and `sdfarm serve --help` differ");
}
