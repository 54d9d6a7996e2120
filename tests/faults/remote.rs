//! Tests that remote workers store their results through the server, not in its folders.

use std::process::{Child, Stdio};

use proto::fail_point;
use rustix::process::Signal;

use crate::jobs;
use crate::support::{Farm, rendered_here, sdfarm, send_signal, wait};

/// Remote worker that is killed on drop.
pub(crate) struct Remote(Child);

impl Remote {
    /// Starts a worker with armed fail points.
    pub(crate) fn start(farm: &Farm, points: Option<&str>) -> Self {
        let mut command = sdfarm(&["worker", "--server", &farm.address, "--device", "cpu", "--threads", "1"]);
        if let Some(points) = points {
            command.arg(fail_point::FLAG).env(fail_point::ENV_VAR, points);
        }
        let started = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        Self(started.expect("the program starts"))
    }

    /// Starts two workers and waits until the farm has them.
    pub(crate) fn pair(farm: &Farm) -> [Self; 2] {
        let pair = [Self::start(farm, None), Self::start(farm, None)];
        farm.joined(2);
        pair
    }

    pub(crate) fn has_ended(&mut self) -> bool {
        self.0.try_wait().expect("a child process").is_some()
    }
}

impl Drop for Remote {
    fn drop(&mut self) {
        send_signal(self.0.id(), Signal::KILL);
        wait(&mut self.0);
    }
}

/// Number of blobs and pictures uploaded to a server.
fn brought(farm: &Farm) -> usize {
    let metrics = farm.get("/metrics").text();
    let puts = metrics.lines().filter(|line| line.starts_with("sdfarm_http_answers_total") && line.contains("\"PUT\""));
    puts.filter(|line| line.contains("/v1/worker/")).count()
}

#[test]
fn only_remote_workers_upload_through_the_server() {
    let job = jobs::many_rays();
    let wanted = rendered_here(&job, 0);
    for workers in ["2", "0"] {
        let farm = Farm::start(&["--workers", workers, "--tile", "96"]);
        let _remotes = (workers == "0").then(|| Remote::pair(&farm));
        let id = farm.accept(&job.to_string());
        farm.succeeded(&id);
        assert!(farm.picture(&id) == wanted, "{workers} workers of the pool");
        assert_eq!(brought(&farm) > 0, workers == "0", "{}", farm.get("/metrics").text());
    }
}
