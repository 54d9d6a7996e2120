//! Jobs in every form that the language has had: `old_jobs/`, shipped or documented with earlier versions, are read as
//! before. `old_jobs/answers.txt` has what each says today; `SDFARM_WRITE_ANSWERS=1` rewrites it.
//!
//! A corrected meaning changes the answers, never these jobs.

use std::fmt::Write as _;
use std::path::Path;

use scene::{PICTURE_VERSION, parse};

const WRITE: &str = "SDFARM_WRITE_ANSWERS";

#[test]
fn old_jobs_say_what_they_said() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/scene/old_jobs");
    let entries =
        std::fs::read_dir(&folder).expect("the folder of old jobs").map(|entry| entry.expect("an entry").path());
    let mut paths: Vec<_> = entries.filter(|path| path.extension().is_some_and(|kind| kind == "json")).collect();
    paths.sort();
    assert!(paths.len() >= 20, "only {} jobs", paths.len());
    let (mut answers, mut wrong) = (format!("Picture version {PICTURE_VERSION}.\n"), Vec::new());
    for path in paths {
        let name = path.file_stem().and_then(|name| name.to_str()).expect("a name");
        let text = std::fs::read(&path).expect("a job");
        let job = match parse(&text) {
            Ok(job) => job,
            Err(error) => {
                wrong.push(format!("{name}: {error}"));
                continue;
            }
        };
        let image = &job.image;
        write!(answers, "\n{name}: {} × {}, {} samples", image.width, image.height, image.samples.max())
            .expect("writing to a string");
        for frame in [0, job.frames.count - 1].into_iter().take(if job.is_animated() { 2 } else { 1 }) {
            match job.at(frame) {
                Ok(at_frame) => {
                    write!(answers, "\n  frame {frame}: {}", at_frame.scene_hash().to_hex())
                        .expect("writing to a string");
                }
                Err(error) => wrong.push(format!("{name}, frame {frame}: {error}")),
            }
        }
    }
    answers.push('\n');
    assert!(wrong.is_empty(), "{} old jobs are refused:\n{}", wrong.len(), wrong.join("\n"));
    let path = folder.join("answers.txt");
    if std::env::var_os(WRITE).is_some() {
        return std::fs::write(path, answers).expect("written");
    }
    let kept = std::fs::read_to_string(path).expect("the answers");
    for (want, got) in kept.lines().zip(answers.lines()) {
        assert_eq!(
            got, want,
            "a job says something else: if a correction intends that, rewrite the answers with {WRITE}=1"
        );
    }
    assert_eq!(kept.lines().count(), answers.lines().count(), "rewrite the answers with {WRITE}=1");
}
