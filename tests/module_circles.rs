//! The modules of each crate form no circle: each can be read, and moved, without those that use it.
//!
//! A module is a file or folder directly in a crate's `src`, with everything under it. It depends on each module that it
//! names by `crate::`, also by a name that the root exports. Tests and comments do not count.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::{fs, io};

use crate::support::root;

/// Modules, and those that each depends on.
type Graph = BTreeMap<String, BTreeSet<String>>;

/// Folders of the crates, as the workspace lists them.
fn crates() -> Vec<PathBuf> {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).expect("it is readable");
    let (_, members) = manifest.split_once("members = [").expect("a workspace");
    let (members, _) = members.split_once(']').expect("a list");
    members.split('"').skip(1).step_by(2).map(|member| root().join(member)).collect()
}

/// Files under a folder with their text, in which only code of the product is left.
fn read_folder(folder: &Path, files: &mut BTreeMap<PathBuf, String>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            read_folder(&path, files)?;
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.insert(path.clone(), fs::read_to_string(&path)?);
        }
    }
    Ok(())
}

/// A file's code without comments and without its tests, and the names of its test modules that have files.
fn product(text: &str) -> (String, Vec<String>) {
    let (mut code, mut test_modules, mut is_test) = (String::new(), Vec::new(), false);
    for line in text.lines().filter(|line| !line.trim_start().starts_with("//")) {
        let item = line.trim();
        if is_test && !item.starts_with("#[") {
            is_test = false;
            match item.split_once("mod ").map(|(_, name)| name.split_once(' ').map_or(name, |(name, _)| name)) {
                Some(name) if item.ends_with(';') => test_modules.push(name.trim_end_matches(';').to_owned()),
                // A module of tests ends its file.
                Some(_) if item.ends_with('{') => break,
                Some(_) | None => code += line,
            }
        } else if item == "#[cfg(test)]" {
            is_test = true;
        } else {
            code += line;
        }
        code.push('\n');
    }
    (code, test_modules)
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

/// Names that the root exports, with the module of each.
fn exports(root: &str) -> BTreeMap<String, String> {
    let mut exports = BTreeMap::new();
    for statement in root.split("use ").skip(1) {
        let statement = statement.split(';').next().unwrap_or_default();
        let Some((module, names)) = statement.split_once("::") else { continue };
        let names = names.strip_prefix('{').map_or_else(|| vec![names], |group| parts_of_group(group));
        for name in names {
            let last = name.rsplit("::").next().unwrap_or(name);
            exports.insert(first_word(last), module.to_owned());
        }
    }
    exports
}

/// Graph of the modules of the crate in a folder.
fn graph(folder: &Path) -> Graph {
    let source = folder.join("src");
    let mut files = BTreeMap::new();
    read_folder(&source, &mut files).expect("the sources are readable");
    let (mut codes, mut test_modules) = (Vec::new(), Vec::new());
    let is_root = |path: &Path| ["lib.rs", "main.rs"].iter().any(|name| path == source.join(name));
    for (path, text) in &files {
        let (code, names) = product(text);
        let children = if is_root(path) { source.clone() } else { path.with_extension("") };
        test_modules.extend(names.iter().map(|name| children.join(name)));
        codes.push((path, code));
    }
    codes.retain(|(path, _)| !test_modules.iter().any(|module| path.with_extension("").starts_with(module)));
    let exports: BTreeMap<_, _> =
        codes.iter().filter(|(path, _)| is_root(path)).flat_map(|(_, code)| exports(code)).collect();
    codes.retain(|(path, _)| !is_root(path));
    let module_of = |path: &Path| {
        let inner = path.strip_prefix(&source).expect("under the source folder").with_extension("");
        inner.iter().next().expect("a file has a name").to_str().expect("UTF-8").to_owned()
    };
    let modules: BTreeSet<String> = codes.iter().map(|(path, _)| module_of(path)).collect();
    let mut graph = Graph::new();
    for (path, code) in &codes {
        let module = module_of(path);
        for name in named_in(code) {
            let used = exports.get(&name).filter(|_| !modules.contains(&name)).cloned().unwrap_or(name);
            if used != module && modules.contains(&used) {
                graph.entry(module.clone()).or_default().insert(used);
            }
        }
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
fn the_modules_of_each_crate_form_no_circle() {
    let crates = crates();
    assert!(crates.len() > 6, "{crates:?}");
    let circles: Vec<String> = crates
        .iter()
        .filter_map(|folder| Some(format!("{}: {}", folder.display(), circle(&graph(folder))?.join(" -> "))))
        .collect();
    assert!(circles.is_empty(), "these modules use each other in a circle:\n{}", circles.join("\n"));
    let server = graph(&root().join("server"));
    assert!(server["http"].contains("queue") && server["queue"].contains("db"), "{server:?}");
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

#[test]
fn tests_and_comments_are_no_product() {
    let text =
        "use crate::a::A;\n// crate::b\n#[cfg(test)]\nmod c;\n#[cfg(test)]\nmod tests {\n    use crate::d::D;\n}\n";
    let (code, test_modules) = product(text);
    assert_eq!(
        (named_in(&code).into_iter().collect::<Vec<_>>(), test_modules),
        (vec!["a".to_owned()], vec!["c".to_owned()])
    );
}

#[test]
fn exported_names_lead_to_their_modules() {
    let exports = exports("mod a;\npub use a::{B, c::D};\npub(crate) use e::F;\n");
    let got: Vec<_> = exports.iter().map(|(name, module)| format!("{module}::{name}")).collect();
    assert_eq!(got, ["a::B", "a::D", "e::F"]);
}
