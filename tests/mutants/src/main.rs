//! Mutants of the server and of the scene language in one program: writes them, drops those that do not compile, and
//! runs the tests against each. The script `run` calls it.

mod instrument;
mod run;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;
use std::process::Command;
use std::{env, fs, io};

use instrument::{Finder, Writer};
use syn::visit::Visit;
use syn::visit_mut::VisitMut;

const MUTANT_RS: &str = include_str!("mutant.rs");

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["instrument", root, tree, ref areas @ ..] => instrument(Path::new(root), Path::new(tree), areas),
        ["blame", tree] => blame(Path::new(tree)),
        ["test", tree, jobs, sample] => run::run(Path::new(tree), number(jobs), number(sample)),
        _ => panic!("usage: mutants instrument ROOT TREE AREA... | blame TREE | test TREE JOBS SAMPLE"),
    }
}

fn number(text: &str) -> usize {
    text.parse().expect("a number")
}

/// Mutants that the compiler rejected.
fn rejected(tree: &Path) -> BTreeSet<u32> {
    let text = fs::read_to_string(tree.join("rejected.txt")).unwrap_or_default();
    text.lines().map(|line| line.parse().expect("a number")).collect()
}

/// Copies the files of `root` to `tree`, with mutants in the files of these areas, and lists the mutants in `mutants.txt`.
fn instrument(root: &Path, tree: &Path, areas: &[&str]) {
    let (rejected, mut next, mut list) = (rejected(tree), 0, String::new());
    let mut written = BTreeMap::new();
    let table = fs::read_to_string(root.join("tests/mutants/areas.txt")).expect("the areas");
    for line in table.lines().filter(|line| !line.starts_with('#')) {
        let mut words = line.split_whitespace();
        let area = words.next().unwrap_or_default();
        for file in words.filter(|_| areas.is_empty() || areas.contains(&area)) {
            let path = root.join(file);
            let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{file}: {error}"));
            let mut syntax = syn::parse_file(&text).expect("it compiles");
            let mut writer = Writer {
                rejected: &rejected,
                mutants: Vec::new(),
                item: String::new(),
                folder: path.parent().expect("a folder"),
                constants: HashMap::new(),
                next,
                fields: file.ends_with("cache_key.rs"),
            };
            writer.constants(&syntax);
            writer.visit_file_mut(&mut syntax);
            next = writer.next;
            for mutant in &writer.mutants {
                list += &format!("{}\t{area}\t{file}\t{}\t{}\n", mutant.number, mutant.line, mutant.what);
            }
            written.insert(file.to_owned(), prettyplease::unparse(&syntax));
            let (name, _) = file.split_once("/src/").expect("a source of a crate");
            let library = fs::read_to_string(root.join(name).join("src/lib.rs")).expect("a library");
            let library = format!("{library}\n#[allow(unused, missing_docs)]\nmod mutant;\n");
            written.insert(format!("{name}/src/lib.rs"), library);
            written.insert(format!("{name}/src/mutant.rs"), MUTANT_RS.to_owned());
        }
    }
    written.insert("mutants.txt".to_owned(), list);
    for file in git_files(root).filter(|file| !written.contains_key(file)) {
        copy(&root.join(&file), &tree.join(&file));
    }
    for (file, text) in written {
        write(&tree.join(file), &text);
    }
}

/// Files that git knows or would add.
fn git_files(root: &Path) -> impl Iterator<Item = String> {
    let mut git = Command::new("git");
    git.args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"]).current_dir(root);
    let names = String::from_utf8(git.output().expect("git is installed").stdout).expect("names in UTF-8");
    names.split_terminator('\0').map(str::to_owned).collect::<Vec<_>>().into_iter()
}

/// Copies a file, unless it is the same already.
fn copy(from: &Path, to: &Path) {
    let Ok(bytes) = fs::read(from) else { return };
    if fs::read(to).is_ok_and(|old| old == bytes) {
        return;
    }
    fs::create_dir_all(to.parent().expect("a folder")).expect("the folder can be made");
    fs::copy(from, to).unwrap_or_else(|error| panic!("{}: {error}", from.display()));
}

/// Writes a file, unless it has this text already, so that little is built again.
fn write(path: &Path, text: &str) {
    if fs::read_to_string(path).is_ok_and(|old| old == text) {
        return;
    }
    fs::create_dir_all(path.parent().expect("a folder")).expect("the folder can be made");
    fs::write(path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}

/// Adds the mutants in which the errors are to `rejected.txt`; the input is what cargo prints as JSON.
fn blame(tree: &Path) {
    let mut rejected = rejected(tree);
    let before = rejected.len();
    let mut files: BTreeMap<String, Vec<(usize, usize)>> = BTreeMap::new();
    for line in io::stdin().lines() {
        let Ok(message) = serde_json::from_str::<serde_json::Value>(&line.expect("text")) else { continue };
        let message = &message["message"];
        if message["level"] != "error" {
            continue;
        }
        eprintln!("{}", message["rendered"].as_str().unwrap_or_default());
        for span in message["spans"].as_array().into_iter().flatten().filter(|span| span["is_primary"] == true) {
            let place = |name: &str| usize::try_from(span[name].as_u64().expect("a number")).expect("it is small");
            let file = span["file_name"].as_str().expect("a file").to_owned();
            files.entry(file).or_default().push((place("line_start"), place("column_start")));
        }
    }
    for (file, places) in files {
        let Ok(text) = fs::read_to_string(tree.join(&file)) else { continue };
        let syntax = syn::parse_file(&text).expect("it was written");
        for (line, column) in places {
            let mut finder = Finder::new(line, column);
            finder.visit_file(&syntax);
            match finder.innermost {
                Some(n) => rejected.extend([n]),
                None => rejected.extend(finder.in_function),
            }
        }
    }
    assert!(rejected.len() > before, "these errors are in no mutant");
    write(&tree.join("rejected.txt"), &rejected.iter().map(|n| format!("{n}\n")).collect::<String>());
}
