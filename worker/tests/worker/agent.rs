//! Tests of the agent against a fake server.

mod delivery;
mod leases;
mod limits;
mod pipeline;
mod registration;

use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use proto::JobId;
use scene::Job;
use tokio_util::sync::CancellationToken;
use worker::agent::{self, AgentConfig, AgentError};
use worker::{CancelFlag, RenderError, Renderer, TilePixels, TileRequest};

use crate::fake_renderer::{FakeRenderer, job_text};
use crate::fake_server::FakeServer;

/// An agent on its own thread.
struct Agent {
    thread: Option<std::thread::JoinHandle<Result<(), AgentError>>>,
    shutdown: CancellationToken,
    _scratch: tempfile::TempDir,
}

impl Agent {
    fn start(server: &FakeServer, renderer: impl Renderer + 'static) -> Self {
        Self::with_grace(server, renderer, Duration::from_mins(1))
    }

    fn with_grace(server: &FakeServer, renderer: impl Renderer + 'static, grace: Duration) -> Self {
        let scratch = tempfile::tempdir().unwrap();
        let config = AgentConfig {
            scratch: scratch.path().to_owned(),
            grace,
            ..AgentConfig::new(vec![server.url().clone()], "tester")
        };
        let shutdown = CancellationToken::new();
        let token = shutdown.clone();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(agent::run(config, Arc::new(renderer), token))
        });
        Self { thread: Some(thread), shutdown, _scratch: scratch }
    }

    /// Waits until it has exited without being stopped.
    fn ended(&mut self) -> Result<(), AgentError> {
        self.thread.take().expect("it is waited for once").join().expect("the agent does not panic")
    }

    fn stop(&mut self) -> Result<(), AgentError> {
        self.shutdown.cancel();
        self.ended()
    }
}

impl Drop for Agent {
    fn drop(&mut self) {
        self.shutdown.cancel();
    }
}

/// Runs a function before it renders, or instead.
struct Acting<F>(F);

impl<F> Renderer for Acting<F>
where
    F: Fn(&TileRequest<'_>, &CancelFlag) -> Result<(), RenderError> + Send + Sync,
{
    fn device(&self) -> String {
        "cuda:4".to_owned()
    }

    fn render(
        &self,
        run: &TileRequest<'_>,
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<TilePixels, RenderError> {
        (self.0)(run, cancel)?;
        FakeRenderer.render(run, &CancelFlag::new(), progress)
    }
}

/// Continues until it is cancelled, which it checks as often as a renderer should.
fn until_cancelled(cancel: &CancelFlag) -> RenderError {
    while !cancel.is_cancelled() {
        std::thread::park_timeout(Duration::from_millis(1));
    }
    RenderError::Cancelled
}

/// Event that happens once, and that tests can wait for.
#[derive(Clone, Default)]
struct Happening(Arc<(Mutex<bool>, Condvar)>);

impl Happening {
    fn happen(&self) {
        *self.0.0.lock().unwrap() = true;
        self.0.1.notify_all();
    }

    fn wait(&self) {
        let deadline = Duration::from_mins(1);
        let happened = self.0.0.lock().unwrap();
        let (happened, _) = self.0.1.wait_timeout_while(happened, deadline, |happened| !*happened).unwrap();
        assert!(*happened, "it never happened");
    }
}

/// Renderer that signals when it has started, and then waits for `go`.
fn gated(begun: &Happening, go: &Happening) -> impl Renderer + use<> {
    let (begun, go) = (begun.clone(), go.clone());
    Acting(move |_: &TileRequest<'_>, cancel: &CancelFlag| {
        begun.happen();
        go.wait();
        assert!(!cancel.is_cancelled(), "nothing was lost");
        Ok(())
    })
}

fn add_job(server: &FakeServer, width: u32, height: u32, image: &str) -> (JobId, Job) {
    let text = job_text(width, height, image, "");
    let job = scene::parse(text.as_bytes()).unwrap();
    (server.change(|farm| farm.add_job(text)), job)
}
