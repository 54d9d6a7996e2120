//! Tests the Helm chart with the program's own help: docker/helm/check.py renders it with helm, and checks every object.

use std::process::Command;

use crate::skip::skip;
use crate::support::{PROGRAM, clean, finish, root, text};

#[test]
fn the_chart_renders_valid_objects_with_variables_that_the_program_has() {
    let packages = root().join(".whl");
    let (helm, folders) = (packages.join("helm/helm"), ["kubernetes", "crds"].map(|name| packages.join(name)));
    let has_python = Command::new("python3").arg("--version").output().is_ok();
    if !has_python || !helm.is_file() || !folders.iter().all(|folder| folder.is_dir()) {
        return skip("helm", "python3, helm or Kubernetes' schemas are not installed, so the chart is not rendered");
    }
    let mut command = Command::new("python3");
    let path = std::env::join_paths(&folders).expect("plain paths");
    clean(&mut command).env("PYTHONPATH", path).arg(root().join("docker/helm/check.py")).arg(helm).arg(PROGRAM);
    let checked = finish(command, b"");
    let printed = text(&checked.stdout);
    assert!(checked.status.success(), "{printed}{}", text(&checked.stderr));
    let objects: u32 = printed.split_whitespace().find_map(|word| word.parse().ok()).expect("a number of objects");
    assert!(objects >= 30, "{printed}");
}
