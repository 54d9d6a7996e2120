//! Runs the tests: each alone, to learn which mutants it reaches; then, for each mutant, the tests that reach it.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::time::{Duration, Instant};
use std::{fs, thread};

/// A test that takes longer alone is not run against mutants.
const MAX_TEST: Duration = Duration::from_secs(60);
/// Time of a mutant's tests, as measured without it; what is not caught by then counts as missed.
const MAX_TESTS: Duration = Duration::from_secs(240);
/// Tests of a binary that run in one process take no longer than this in total, before the first failure is noticed.
const MAX_CHUNK: Duration = Duration::from_secs(4);
/// Time limit of the tests of a mutant: this factor, as measured without it, and these seconds.
const TIMEOUT_FACTOR: u32 = 10;
const TIMEOUT_EXTRA: Duration = Duration::from_secs(20);
const TICK: Duration = Duration::from_millis(10);

/// One test, and what was learned about it.
#[derive(Clone, Debug)]
struct Test {
    binary: usize,
    name: String,
    took: Duration,
    reached: BTreeSet<u32>,
}

#[derive(Debug)]
struct Binary {
    path: PathBuf,
    folder: PathBuf,
    name: String,
}

struct Mutant {
    number: u32,
    area: String,
    file: String,
    line: String,
    what: String,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Outcome {
    Passed,
    Failed,
    TimedOut,
}

/// Runs some tests of a binary in one process.
fn execute(binary: &Binary, names: &[&str], limit: Duration, variable: (&str, &str)) -> Outcome {
    let mut command = Command::new(&binary.path);
    command.args(names).args(["--exact", "--test-threads=4", "-q"]).current_dir(&binary.folder);
    command.env("CARGO_MANIFEST_DIR", &binary.folder).env(variable.0, variable.1);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).process_group(0);
    let mut child = command.spawn().expect("it was built");
    // Counted rather than measured, so that it does not run out while all processes are suspended.
    let mut waited = Duration::ZERO;
    let outcome = loop {
        match child.try_wait().expect("it is our child") {
            Some(status) if status.success() => break Outcome::Passed,
            Some(_) => break Outcome::Failed,
            None if waited > limit => break Outcome::TimedOut,
            None => thread::sleep(TICK),
        }
        waited += TICK;
    };
    // The whole group, because a test starts servers and workers.
    let _ = Command::new("kill").args(["-KILL", "--", &format!("-{}", child.id())]).stderr(Stdio::null()).status();
    let _ = child.wait();
    outcome
}

/// Applies a function to each item, on `jobs` threads.
fn in_parallel<T: Send, R: Send>(jobs: usize, items: Vec<T>, work: impl Fn(T) -> R + Sync) -> Vec<R> {
    let queue = Mutex::new(items.into_iter().enumerate().collect::<VecDeque<_>>());
    let results = Mutex::new(BTreeMap::new());
    thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                loop {
                    let Some((index, item)) = queue.lock().expect("no panic").pop_front() else { return };
                    let result = work(item);
                    results.lock().expect("no panic").insert(index, result);
                }
            });
        }
    });
    results.into_inner().expect("no panic").into_values().collect()
}

/// The lines of `tests.txt` (package, binary or `lib`, and filters) with what cargo built.
fn tests(tree: &Path) -> (Vec<Binary>, Vec<Test>) {
    let built = fs::read_to_string(tree.join("built.json")).expect("what cargo printed");
    let messages: Vec<serde_json::Value> = built.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    let (mut binaries, mut tests) = (Vec::new(), Vec::new());
    for line in fs::read_to_string(tree.join("tests/mutants/tests.txt")).expect("the tests").lines() {
        let words: Vec<&str> = line.split_whitespace().filter(|_| !line.starts_with('#')).collect();
        let [package, name, ref filters @ ..] = words[..] else { continue };
        let artifact = messages
            .iter()
            .find(|message| {
                let target = &message["target"];
                message["profile"]["test"] == true
                    && if name == "lib" {
                        target["kind"][0] == "lib"
                    } else {
                        target["kind"][0] == "test" && target["name"] == name
                    }
                    && message["manifest_path"]
                        .as_str()
                        .is_some_and(|path| path.ends_with(&format!("/{package}/Cargo.toml")))
            })
            .unwrap_or_else(|| panic!("{line}: it was not built"));
        let binary = Binary {
            path: artifact["executable"].as_str().expect("a path").into(),
            folder: tree.join(package),
            name: format!("{package}/{name}"),
        };
        let mut list = Command::new(&binary.path);
        list.args(["--list", "--format", "terse"]).args(filters).current_dir(&binary.folder);
        for test in String::from_utf8(list.output().expect("it was built").stdout)
            .expect("names")
            .lines()
            .filter_map(|line| line.strip_suffix(": test"))
        {
            let (took, reached) = (Duration::ZERO, BTreeSet::new());
            tests.push(Test { binary: binaries.len(), name: test.to_owned(), took, reached });
        }
        binaries.push(binary);
    }
    (binaries, tests)
}

/// Runs each test alone; drops those that fail or take too long.
fn baseline(tree: &Path, jobs: usize, binaries: &[Binary], tests: Vec<Test>) -> Vec<Test> {
    let files = tree.join("reached");
    let _ = fs::remove_dir_all(&files);
    fs::create_dir_all(&files).expect("a folder");
    let numbered = tests.into_iter().enumerate().collect();
    let done = in_parallel(jobs, numbered, |(index, mut test): (usize, Test)| {
        let file = files.join(index.to_string());
        let variable = ("SDFARM_MUTANT_REACHED", file.to_str().expect("text"));
        let start = Instant::now();
        let outcome = execute(&binaries[test.binary], &[&test.name], MAX_TEST, variable);
        test.took = start.elapsed();
        let text = fs::read_to_string(&file).unwrap_or_default();
        test.reached = text.lines().filter_map(|n| n.parse().ok()).collect();
        if outcome != Outcome::Passed {
            let why = if outcome == Outcome::Failed { "fails alone" } else { "is slow" };
            println!("not used: {} {} {why}", binaries[test.binary].name, test.name);
        }
        (outcome == Outcome::Passed && !test.reached.is_empty()).then_some(test)
    });
    let mut tests: Vec<Test> = done.into_iter().flatten().collect();
    tests.sort_by_key(|test| (test.took, test.name.clone()));
    tests
}

/// The binary and the test among which one fails for a mutant; `None` if it is missed.
fn caught(number: u32, binaries: &[Binary], tests: &[Test]) -> Option<String> {
    let mut left: VecDeque<&Test> = tests.iter().filter(|test| test.reached.contains(&number)).collect();
    let mut spent = Duration::ZERO;
    while let Some(first) = left.pop_front() {
        let (mut chunk, mut took) = (vec![first.name.as_str()], first.took);
        left.retain(|test| {
            let fits = test.binary == first.binary && took + test.took <= MAX_CHUNK;
            if fits {
                chunk.push(&test.name);
                took += test.took;
            }
            !fits
        });
        if spent > MAX_TESTS {
            return None;
        }
        spent += took;
        let limit = took * TIMEOUT_FACTOR + TIMEOUT_EXTRA;
        let outcome = execute(&binaries[first.binary], &chunk, limit, ("SDFARM_MUTANT", &number.to_string()));
        let binary = &binaries[first.binary].name;
        match outcome {
            Outcome::Passed => {}
            Outcome::Failed => return Some(format!("{binary} {} of {}", chunk[0], chunk.len())),
            Outcome::TimedOut => return Some(format!("{binary} hangs")),
        }
    }
    None
}

/// At most `sample` mutants of each area, evenly spread over its files.
fn choose(mutants: Vec<Mutant>, sample: usize) -> Vec<Mutant> {
    let mut areas: BTreeMap<String, Vec<Mutant>> = BTreeMap::new();
    for mutant in mutants {
        areas.entry(mutant.area.clone()).or_default().push(mutant);
    }
    let even = |mutants: Vec<Mutant>| {
        let count = mutants.len();
        let keep = move |index: usize| index * sample / count != (index + 1) * sample / count;
        mutants
            .into_iter()
            .enumerate()
            .filter(move |(index, _)| count <= sample || keep(*index))
            .map(|(_, mutant)| mutant)
    };
    areas.into_values().flat_map(even).collect()
}

pub fn run(tree: &Path, jobs: usize, sample: usize) {
    let (binaries, tests) = tests(tree);
    let start = Instant::now();
    let tests = baseline(tree, jobs, &binaries, tests);
    println!("{} tests reach a mutant; run one by one in {} s", tests.len(), start.elapsed().as_secs());
    let list = fs::read_to_string(tree.join("mutants.txt")).expect("the mutants");
    let mutants = list.lines().map(|line| {
        let words: Vec<&str> = line.splitn(5, '\t').collect();
        let [number, area, file, line, what] = words[..] else { panic!("{line}") };
        let [area, file, line, what] = [area, file, line, what].map(str::to_owned);
        Mutant { number: number.parse().expect("a number"), area, file, line, what }
    });
    let reasons: HashMap<(String, String), String> = fs::read_to_string(tree.join("tests/mutants/equivalent.txt"))
        .unwrap_or_default()
        .lines()
        .filter_map(|line| {
            let (mutant, reason) = line.rsplit_once(" | ")?;
            let (file, what) = mutant.split_once(' ')?;
            Some(((file.to_owned(), what.to_owned()), reason.to_owned()))
        })
        .collect();
    let (equivalent, mutants): (Vec<_>, Vec<_>) = choose(mutants.collect(), sample)
        .into_iter()
        .partition(|mutant| reasons.contains_key(&(mutant.file.clone(), mutant.what.clone())));
    let mut counts: BTreeMap<String, [usize; 3]> = BTreeMap::new();
    for mutant in &equivalent {
        counts.entry(mutant.area.clone()).or_default()[2] += 1;
    }
    let start = Instant::now();
    let log = Mutex::new(fs::File::create(tree.join("results.txt")).expect("a file"));
    let results = in_parallel(jobs, mutants, |mutant| {
        use std::io::Write;
        let by = caught(mutant.number, &binaries, &tests);
        let words = by.as_deref().unwrap_or(if tests.iter().any(|test| test.reached.contains(&mutant.number)) {
            "MISSED"
        } else {
            "MISSED, not reached"
        });
        let Mutant { number, file, line, what, .. } = &mutant;
        writeln!(log.lock().expect("no panic"), "{number}\t{file}:{line}\t{what}\t{words}")
            .expect("the disk has space");
        (by.is_some(), mutant)
    });
    for (caught, mutant) in &results {
        counts.entry(mutant.area.clone()).or_default()[usize::from(!caught)] += 1;
        if !caught {
            println!("missed: {}:{} {} [{}]", mutant.file, mutant.line, mutant.what, mutant.number);
        }
    }
    println!("{} mutants in {} s", results.len(), start.elapsed().as_secs());
    println!("\n| Area | Caught | Missed | Caught of all | Equivalent |\n|---|---|---|---|---|");
    for (area, [caught, missed, equivalent]) in counts {
        let percent = 100.0 * caught as f64 / (caught + missed).max(1) as f64;
        println!("| {area} | {caught} | {missed} | {percent:.0} % | {equivalent} |");
    }
}
