//! The commands, one module each: its arguments and its implementation.

mod audit;
mod backup;
mod bench;
mod cancel;
mod check;
mod delete;
mod demo;
mod diff;
mod doctor;
mod explain;
mod export;
mod fetch;
mod file;
mod fmt;
mod forget;
mod gc;
mod history;
mod jobs;
mod key;
mod link;
mod migrate;
mod r#move;
mod new;
mod open;
mod pause;
mod pool;
mod preview;
mod price;
mod priority;
mod render;
mod reorder;
mod restore;
mod resubmit;
mod retry;
mod schema;
mod selftest;
mod serve;
mod status;
mod submit;
mod tiles;
mod top;
mod verify;
mod watch;
mod webhook;
mod worker;
mod workers;

use std::fs::Permissions;
use std::future::Future;
use std::os::unix::fs::PermissionsExt;
use std::time::Duration;

use anyhow::Context;
use clap::Subcommand;
use tempfile::TempDir;

use crate::signals::Signals;
use crate::terminal::write_bytes;

/// How long blocking calls may go on after a command has finished.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(500);

/// Folder for a farm that is deleted with it; only its owner can read it.
fn temporary_farm_folder() -> anyhow::Result<TempDir> {
    let folder = tempfile::Builder::new().permissions(Permissions::from_mode(0o700)).tempdir();
    folder.context("could not create a folder for the farm: free some space there")
}

/// Command to run.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Run the farm: the HTTP API, the queue, and workers on this machine.
    Serve(serve::Arguments),
    /// Run a worker: render tiles for a server until it drains the worker or you stop it.
    Worker(worker::Arguments),
    /// Render one picture on this machine, without a server.
    Render(render::Arguments),
    /// Submit a job to a server.
    Submit(submit::Arguments),
    /// Follow a job until it is finished.
    Watch(watch::Arguments),
    /// Save a stored picture of a job.
    Fetch(fetch::Arguments),
    /// Save a job's file as it was submitted.
    File(file::Arguments),
    /// Submit a job's file again, optionally with changes.
    Resubmit(resubmit::Arguments),
    /// Save the finished part of a picture.
    Preview(preview::Arguments),
    /// Create a signed link to a picture, which works without a key until it expires.
    Link(link::Arguments),
    /// Verify a picture by rendering it again.
    Verify(verify::Arguments),
    /// Forget a wrong picture everywhere, and render the frames that showed it again.
    Forget(forget::Arguments),
    /// Remove jobs past their retention, or list them (--dry-run).
    Gc(gc::Arguments),
    /// List jobs, newest first.
    Jobs(jobs::Arguments),
    /// Cancel a job.
    Cancel(cancel::Arguments),
    /// Retry a failed job: render its dead tiles again.
    Retry(retry::Arguments),
    /// Change a job's priority.
    Priority(priority::Arguments),
    /// Move a job in the queue, before or after another one.
    Reorder(reorder::Arguments),
    /// Delete a job and its pictures, or list what would be deleted (--dry-run).
    Delete(delete::Arguments),
    /// Pause a job or the whole farm; running tiles finish.
    Pause(pause::Arguments),
    /// Resume a paused job, or the paused farm.
    Resume(pause::Arguments),
    /// Show the secret that signs a server's webhooks.
    Webhook(webhook::Arguments),
    /// Show the server's own workers, or set their number.
    Pool(pool::Arguments),
    /// List workers, or drain, quarantine or release one.
    Workers(workers::Arguments),
    /// Show the farm's throughput of the last hour, day or week.
    History(history::Arguments),
    /// List a job's tiles: who rendered which, when, and how long it took.
    Tiles(tiles::Arguments),
    /// Create, list, or revoke API keys.
    Key(key::Arguments),
    /// List the audit log: who changed what.
    Audit(audit::Arguments),
    /// Write a first job file to start from.
    New(new::Arguments),
    /// Check a job file: report every error with its line and column.
    Check(check::Arguments),
    /// Estimate a job's time and cost, map its time, and suggest savings.
    Price(price::Arguments),
    /// Format job files; their comments are kept.
    Fmt(fmt::Arguments),
    /// Describe the differences of two job files and of their pictures.
    Diff(diff::Arguments),
    /// Print the JSON Schema of a job file.
    Schema(schema::Arguments),
    /// Show a job's size in nodes, rays and operations, or its GPU program (--cuda).
    Explain(explain::Arguments),
    /// Write a job in the format of another render farm.
    Export(export::Arguments),
    /// Measure how fast this machine renders.
    Bench(bench::Arguments),
    /// Check that this machine renders bit-identical pictures.
    Selftest(selftest::Arguments),
    /// Open a farm's page in the browser, or print its address.
    Open(open::Arguments),
    /// Show a farm on one screen: queue, workers, disk, and warnings.
    Status(status::Arguments),
    /// Show a farm live in the terminal; q quits.
    Top(top::Arguments),
    /// Back up a farm while it runs: its database and its new pictures.
    Backup(backup::Arguments),
    /// Restore a farm from a backup into a new folder.
    Restore(restore::Arguments),
    /// Apply the migrations of this release to a farm's database, without starting a server.
    Migrate(migrate::Arguments),
    /// Move the database of a stopped farm to a PostgreSQL server, its pictures to a bucket, or either back.
    Move(r#move::Arguments),
    /// Check a farm's data folder and machine, and suggest fixes.
    Doctor(doctor::Arguments),
    /// Start a farm, render a shipped scene on it, save the picture, and stop.
    Demo(demo::Arguments),
    /// Draw previews and measure samples for a server.
    #[command(hide = true)]
    PreviewHelper,
    /// Read job files for a server.
    #[command(hide = true)]
    JobReader,
}

impl Command {
    /// Whether the command runs until it is stopped.
    pub(crate) fn is_long_lived(&self) -> bool {
        matches!(self, Self::Serve(_) | Self::Worker(_))
    }

    /// Runs the command; an error becomes the exit code.
    pub(crate) fn run(self) -> anyhow::Result<()> {
        match self {
            Self::Serve(arguments) => run_async(serve::run(arguments)),
            Self::Worker(arguments) => run_async(worker::run(arguments)),
            Self::Render(arguments) => render::run(&arguments),
            Self::Submit(arguments) => run_async(interruptible(submit::run(arguments))),
            Self::Watch(arguments) => run_async(interruptible(watch::run(arguments))),
            Self::Fetch(arguments) => run_async(interruptible(fetch::run(arguments))),
            Self::File(arguments) => run_async(interruptible(file::run(arguments))),
            Self::Resubmit(arguments) => run_async(interruptible(resubmit::run(arguments))),
            Self::Preview(arguments) => run_async(interruptible(preview::run(arguments))),
            Self::Link(arguments) => run_async(interruptible(link::run(arguments))),
            Self::Verify(arguments) => run_async(interruptible(verify::run(arguments))),
            Self::Forget(arguments) => run_async(interruptible(forget::run(arguments))),
            Self::Gc(arguments) => run_async(interruptible(gc::run(arguments))),
            Self::Jobs(arguments) => run_async(interruptible(jobs::run(arguments))),
            Self::Cancel(arguments) => run_async(interruptible(cancel::run(arguments))),
            Self::Retry(arguments) => run_async(interruptible(retry::run(arguments))),
            Self::Priority(arguments) => run_async(interruptible(priority::run(arguments))),
            Self::Reorder(arguments) => run_async(interruptible(reorder::run(arguments))),
            Self::Delete(arguments) => run_async(interruptible(delete::run(arguments))),
            Self::Pause(arguments) => run_async(interruptible(pause::run(arguments, true))),
            Self::Resume(arguments) => run_async(interruptible(pause::run(arguments, false))),
            Self::Webhook(arguments) => webhook::run(&arguments),
            Self::Pool(arguments) => run_async(interruptible(pool::run(arguments))),
            Self::Workers(arguments) => run_async(interruptible(workers::run(arguments))),
            Self::History(arguments) => run_async(interruptible(history::run(arguments))),
            Self::Tiles(arguments) => run_async(interruptible(tiles::run(arguments))),
            Self::Key(arguments) => run_async(key::run(arguments)),
            Self::Audit(arguments) => run_async(interruptible(audit::run(arguments))),
            Self::New(arguments) => new::run(&arguments),
            Self::Check(arguments) => check::run(&arguments),
            Self::Price(arguments) => run_async(interruptible(price::run(arguments))),
            Self::Fmt(arguments) => fmt::run(&arguments),
            Self::Diff(arguments) => diff::run(&arguments),
            Self::Schema(arguments) => schema::run(&arguments),
            Self::Explain(arguments) => explain::run(&arguments),
            Self::Export(arguments) => export::run(&arguments),
            Self::Bench(arguments) => bench::run(&arguments),
            Self::Selftest(arguments) => selftest::run(&arguments),
            Self::Open(arguments) => run_async(interruptible(open::run(arguments))),
            Self::Status(arguments) => run_async(interruptible(status::run(arguments))),
            Self::Top(arguments) => run_async(interruptible(top::run(arguments))),
            Self::Backup(arguments) => run_async(interruptible(backup::run(arguments))),
            Self::Restore(arguments) => run_async(interruptible(restore::run(arguments))),
            Self::Migrate(arguments) => run_async(interruptible(migrate::run(arguments))),
            Self::Move(arguments) => run_async(interruptible(r#move::run(arguments))),
            Self::Doctor(arguments) => run_async(interruptible(doctor::run(arguments))),
            Self::Demo(arguments) => run_async(demo::run(arguments)),
            Self::PreviewHelper => write_bytes(&helper::run()?),
            Self::JobReader => server::read_jobs().context("could not read jobs"),
        }
    }
}

fn run_async<T>(work: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("could not start the network threads")?;
    let done = runtime.block_on(work);
    // A blocking call that does not return, such as a render that hangs, must not keep the process.
    runtime.shutdown_timeout(SHUTDOWN_TIMEOUT);
    done
}

/// Runs work that Ctrl-C may drop at any time, together with its temporary files.
async fn interruptible(work: impl Future<Output = anyhow::Result<()>>) -> anyhow::Result<()> {
    let mut signals = Signals::install()?;
    tokio::select! {
        done = work => done,
        () = signals.next() => anyhow::bail!("interrupted"),
    }
}
