//! The modules of the server form no circle: each can be read, and moved, without those that use it.
//!
//! A module is a file or folder directly in `server/src`, with everything under it. It depends on each module that it
//! names by `crate::`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::{fs, io};

/// Files that have no module of their own: the list of modules, and what is public.
const ROOT: &str = "lib";

/// Modules, and those that each depends on.
type Graph = BTreeMap<String, BTreeSet<String>>;

/// Module that a file belongs to.
fn module_of(source: &Path, file: &Path) -> String {
    let inner = file.strip_prefix(source).expect("under the source folder");
    let first = inner.iter().next().expect("a file has a name").to_str().expect("UTF-8");
    first.strip_suffix(".rs").unwrap_or(first).to_owned()
}

fn read_folder(source: &Path, folder: &Path, texts: &mut Vec<(String, String)>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            read_folder(source, &path, texts)?;
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            texts.push((module_of(source, &path), fs::read_to_string(&path)?));
        }
    }
    Ok(())
}

/// Names that follow each `crate::` of a text, in braces also several.
fn named_in(text: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for rest in text.split("crate::").skip(1) {
        match rest.strip_prefix('{') {
            Some(group) => names.extend(parts_of_group(group).into_iter().map(first_word)),
            None => {
                names.insert(first_word(rest));
            }
        }
    }
    names.remove("");
    names
}

/// Parts of a group in braces, which may have groups of their own.
fn parts_of_group(group: &str) -> Vec<&str> {
    let (mut parts, mut start, mut depth) = (Vec::new(), 0, 0);
    for (at, letter) in group.char_indices() {
        match letter {
            '{' => depth += 1,
            '}' if depth == 0 => {
                parts.push(group[start..at].trim());
                return parts;
            }
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(group[start..at].trim());
                start = at + 1;
            }
            _ => {}
        }
    }
    parts
}

fn first_word(text: &str) -> String {
    text.chars().take_while(|letter| letter.is_alphanumeric() || *letter == '_').collect()
}

/// Graph of the modules of the server; panics if one takes something from the root, which depends on all.
fn graph() -> Graph {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut texts = Vec::new();
    read_folder(&source, &source, &mut texts).expect("the sources are readable");
    let modules: BTreeSet<String> = texts.iter().map(|(module, _)| module.clone()).collect();
    let mut graph = Graph::new();
    for (module, text) in texts.iter().filter(|(module, _)| module != ROOT) {
        for name in named_in(text) {
            assert!(modules.contains(&name), "{module} uses crate::{name}, which is not in a module: move it into one");
            graph.entry(module.clone()).or_default().insert(name);
        }
    }
    for (module, used) in &mut graph {
        used.remove(module);
    }
    graph
}

/// A circle of a graph, as the modules on the way from one back to it; `None` if there is none.
fn circle(graph: &Graph) -> Option<Vec<String>> {
    let mut cleared = BTreeSet::new();
    graph.keys().find_map(|module| circle_through(graph, module, &mut Vec::new(), &mut cleared))
}

fn circle_through(
    graph: &Graph,
    module: &str,
    way: &mut Vec<String>,
    cleared: &mut BTreeSet<String>,
) -> Option<Vec<String>> {
    if let Some(start) = way.iter().position(|passed| passed == module) {
        return Some(way[start..].iter().cloned().chain([module.to_owned()]).collect());
    }
    if cleared.contains(module) {
        return None;
    }
    way.push(module.to_owned());
    let found = graph.get(module).into_iter().flatten().find_map(|next| circle_through(graph, next, way, cleared));
    way.pop();
    cleared.insert(module.to_owned());
    found
}

#[test]
fn the_modules_of_the_server_form_no_circle() {
    let graph = graph();
    assert!(graph["http"].contains("queue") && graph["queue"].contains("db"), "{graph:?}");
    if let Some(circle) = circle(&graph) {
        panic!("these modules use each other in a circle: {}", circle.join(" -> "));
    }
}

#[test]
fn a_circle_is_found_and_named() {
    let graph = |edges: &[(&str, &str)]| {
        let mut graph = Graph::new();
        for (from, to) in edges {
            graph.entry((*from).to_owned()).or_default().insert((*to).to_owned());
        }
        graph
    };
    assert_eq!(circle(&graph(&[("a", "b"), ("a", "c"), ("b", "d"), ("c", "d")])), None);
    let found = circle(&graph(&[("a", "b"), ("b", "c"), ("c", "d"), ("d", "b")])).expect("a circle");
    assert_eq!(found.join(" "), "b c d b");
}

#[test]
fn every_way_to_name_a_module_is_found() {
    let text = "use crate::queue::{Queue, claim};\nuse crate::{clock, pool::{Pool, Slot}, budget};\n fn f(x: crate::lock::Lock) {}";
    let names: Vec<_> = named_in(text).into_iter().collect();
    assert_eq!(names, ["budget", "clock", "lock", "pool", "queue"]);
}
