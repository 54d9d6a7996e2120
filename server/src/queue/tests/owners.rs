//! Rows with effects are changed only where the effects are written: other modules have no such statement.

use std::path::{Path, PathBuf};
use std::{fs, io};

/// Statement that only some files may have.
struct Rule {
    /// Its beginning.
    start: &'static str,
    /// Texts that the part up to `WHERE` must have one of; none if every such statement counts.
    sets: &'static [&'static str],
    /// Files under `queue/`.
    owners: &'static [&'static str],
}

const RULES: [Rule; 15] = [
    Rule {
        start: "UPDATE job SET",
        sets: &[" state =", " finished_at_ms =", " priority =", " submitter =", " paused =", " rays_peak ="],
        owners: &["jobs/transitions.rs"],
    },
    Rule { start: "INSERT INTO job ", sets: &[], owners: &["jobs/transitions.rs"] },
    Rule { start: "DELETE FROM job ", sets: &[], owners: &["jobs/transitions.rs"] },
    Rule { start: "UPDATE tile SET", sets: &["'done'"], owners: &["tiles/results.rs"] },
    // These change tiles that are not done, to states other than done.
    Rule {
        start: "UPDATE tile SET",
        sets: &[" state ="],
        owners: &[
            "tiles/results.rs",
            "leases/claim.rs",
            "jobs/cleanup.rs",
            "leases.rs",
            "servers.rs",
            "frames/stitch.rs",
            "tiles/undo.rs",
        ],
    },
    Rule { start: "UPDATE frame SET", sets: &["'stored'"], owners: &["frames/picture.rs"] },
    Rule { start: "INSERT INTO frame", sets: &["'stored'"], owners: &["frames/open.rs"] },
    Rule { start: "UPDATE lease SET", sets: &[" ended ="], owners: &["leases/ends.rs"] },
    Rule { start: "INSERT INTO outbox", sets: &[], owners: &["events/effects/outbox.rs"] },
    Rule { start: "INSERT INTO job_change", sets: &[], owners: &["events/effects/changes.rs"] },
    Rule { start: "INSERT INTO delivery", sets: &[], owners: &["events/effects/outbox.rs"] },
    Rule { start: "INSERT INTO backlog", sets: &[], owners: &["events/effects/books.rs"] },
    Rule { start: "UPDATE backlog", sets: &[], owners: &["events/effects/books.rs"] },
    Rule { start: "INSERT INTO share ", sets: &[], owners: &["events/effects/books.rs"] },
    Rule {
        start: "UPDATE share",
        sets: &[],
        owners: &["events/effects/books.rs", "jobs/fair_share.rs", "servers/repair.rs"],
    },
];

impl Rule {
    /// Whether a text that begins where the statement does is such a statement.
    fn applies(&self, text: &str) -> bool {
        let Some(rest) = text.strip_prefix(self.start) else { return false };
        let statement = rest.split(['"', ';']).next().unwrap_or_default();
        let set = statement.split(" WHERE ").next().unwrap_or_default();
        self.sets.is_empty() || self.sets.iter().any(|text| set.contains(text))
    }
}

/// Source files, but for tests.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let is_test = path.file_stem().is_some_and(|name| name == "tests");
        if path.is_dir() && !is_test {
            sources(&path, found)?;
        } else if path.extension().is_some_and(|extension| extension == "rs") && !is_test {
            found.push(path);
        }
    }
    Ok(())
}

#[test]
fn what_has_effects_is_changed_only_by_its_owners() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files).expect("the sources are readable");
    let mut used = vec![0_usize; RULES.len()];
    let mut strangers = Vec::new();
    for path in files {
        let text = fs::read_to_string(&path).expect("a source file");
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        let name = path.strip_prefix(&root).expect("under the root").display().to_string();
        for (rule, used) in RULES.iter().zip(&mut used) {
            for (at, _) in text.match_indices(rule.start).filter(|(at, _)| rule.applies(&text[*at..])) {
                *used += 1;
                if !rule.owners.iter().any(|owner| name == format!("queue/{owner}")) {
                    let statement: String = text[at..].chars().take(100).collect();
                    strangers.push(format!("{name}: {statement}"));
                }
            }
        }
    }
    assert!(strangers.is_empty(), "belongs to a module that writes its effects:\n{}", strangers.join("\n"));
    for (rule, used) in RULES.iter().zip(used) {
        assert!(used > 0, "no statement begins with {:?}", rule.start);
    }
}
