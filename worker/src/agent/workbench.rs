//! Where runs are worked off: rendered one after another on the device, delivered
//! meanwhile. It knows leases only as things that may be dropped.

use std::any::Any;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use proto::work::{LeasedTile, Outcome, Report, Run, Work};
use proto::{JobId, LeaseId};
use scene::Job;
use tokio::sync::Semaphore;
use tokio::sync::mpsc::UnboundedSender;
use tokio::task::{JoinError, JoinSet, spawn_blocking};
use tokio_util::sync::CancellationToken;

use super::back_off::BackOff;
use super::deliver::nobody_waits;
use super::jobs::{JobError, Jobs};
use super::link::Link;
use crate::renderer::{Cancel, Pixels, RenderError, Renderer, TileRun};

/// Tiles being delivered while the next one renders.
const MAX_DELIVERIES: usize = 2;

/// What a session hears from its runs.
#[derive(Debug)]
pub(super) enum Event {
    /// Leases are finished with, together.
    Finished(Vec<Report>),
    /// A run needs the device no more.
    Rendered,
    /// A tile was rendered at so many camera rays a second.
    Speed(f64),
    /// The server stored something.
    Stored,
    /// The server could not store something.
    NotStored,
}

/// A worker's side of a lease.
#[derive(Clone, Debug)]
pub(super) struct Hold {
    /// Which one.
    pub(super) lease: LeaseId,
    /// Stops its render.
    pub(super) cancel: Cancel,
    /// Cancelled when nobody waits for its result any more.
    pub(super) dropped: CancellationToken,
}

impl Hold {
    pub(super) fn new(lease: LeaseId) -> Self {
        Self { lease, cancel: Cancel::new(), dropped: CancellationToken::new() }
    }

    /// Stops whatever is done for it.
    pub(super) fn drop_it(&self) {
        self.cancel.cancel();
        self.dropped.cancel();
    }

    pub(super) fn report(&self, outcome: Outcome) -> Report {
        Report { lease: self.lease, outcome }
    }
}

/// The leases of a run, in its order.
pub(super) fn leases(run: &Run) -> impl Iterator<Item = LeaseId> {
    let leases: Vec<LeaseId> = match &run.work {
        Work::Render { tiles, .. } => tiles.iter().map(|tile| tile.lease).collect(),
        Work::Stitch { lease, .. } => vec![*lease],
    };
    leases.into_iter()
}

/// A device, and the way to the server.
pub(super) struct Workbench {
    pub(super) link: Arc<Link>,
    pub(super) scratch: PathBuf,
    renderer: Arc<dyn Renderer>,
    device: Semaphore,
    jobs: Jobs,
    events: UnboundedSender<Event>,
}

impl Workbench {
    pub(super) fn new(
        link: Arc<Link>,
        renderer: Arc<dyn Renderer>,
        scratch: PathBuf,
        events: UnboundedSender<Event>,
    ) -> Self {
        Self { link, scratch, renderer, device: Semaphore::new(1), jobs: Jobs::default(), events }
    }

    /// Works off a run; every lease ends in a report, unless it was dropped.
    pub(super) async fn run(self: Arc<Self>, run: Run, holds: Vec<Hold>) {
        let job = tokio::select! {
            job = self.job(run.job) => job,
            () = nobody_waits(&holds) => return self.tell(Event::Rendered),
        };
        let job = match job {
            Ok(job) => job,
            Err(error) => {
                self.tell(Event::Rendered);
                return self.give_up(&holds, &error);
            }
        };
        match run.work {
            Work::Stitch { parts, .. } => self.stitch(&job, run.frame, &parts, &holds[0]).await,
            Work::Render { tiles, whole_frame: true } => self.render_whole(job, run.frame, &tiles, &holds).await,
            Work::Render { tiles, whole_frame: false } => self.render_tiles(job, run.frame, &tiles, &holds).await,
        }
    }

    /// A job, as soon as the server is there to give it.
    async fn job(&self, id: JobId) -> Result<Arc<Job>, JobError> {
        let mut back_off = BackOff::new(Duration::from_millis(50), Duration::from_secs(2));
        loop {
            match self.jobs.get(&self.link, id).await {
                Err(JobError::Link(error)) if error.is_absence() => back_off.pause().await,
                job => return job,
            }
        }
    }

    pub(super) fn tell(&self, event: Event) {
        // The session may be over; then nobody needs to know.
        self.events.send(event).unwrap_or_default();
    }

    /// Ends leases in the same way, and all at once.
    pub(super) fn finish(&self, holds: &[Hold], outcome: &Outcome) {
        self.tell(Event::Finished(holds.iter().map(|hold| hold.report(outcome.clone())).collect()));
    }

    fn give_up(&self, holds: &[Hold], error: &JobError) {
        tracing::warn!(%error, "could not start a run");
        match error {
            JobError::Link(_) => {
                self.tell(Event::NotStored);
                self.finish(holds, &Outcome::HandedBack);
            }
            JobError::Refused(_) | JobError::Panicked => {
                self.finish(holds, &Outcome::Failed { message: error.to_string() });
            }
        }
    }

    /// Renders tiles, each delivered as a blob while the next renders.
    async fn render_tiles(self: &Arc<Self>, job: Arc<Job>, frame: u32, tiles: &[LeasedTile], holds: &[Hold]) {
        let device = self.device.acquire().await.expect("the semaphore is never closed");
        let mut deliveries = JoinSet::new();
        for (tile, hold) in tiles.iter().zip(holds) {
            let Some(pixels) = self.render(&job, frame, *tile, hold).await else { continue };
            while deliveries.len() >= MAX_DELIVERIES {
                deliveries.join_next().await;
            }
            deliveries.spawn(self.clone().deliver_blob(pixels, hold.clone()));
        }
        drop(device);
        self.tell(Event::Rendered);
        while deliveries.join_next().await.is_some() {}
    }

    /// Renders a whole frame and delivers its picture. If some tile failed or was dropped,
    /// the others are delivered as blobs.
    async fn render_whole(self: &Arc<Self>, job: Arc<Job>, frame: u32, tiles: &[LeasedTile], holds: &[Hold]) {
        let device = self.device.acquire().await.expect("the semaphore is never closed");
        let mut rendered = Vec::new();
        for (tile, hold) in tiles.iter().zip(holds) {
            if let Some(pixels) = self.render(&job, frame, *tile, hold).await {
                rendered.push((pixels, hold.clone()));
            }
        }
        drop(device);
        self.tell(Event::Rendered);
        if rendered.len() == tiles.len() {
            let (tiles, holds): (Vec<Pixels>, Vec<Hold>) = rendered.into_iter().unzip();
            return self.deliver_frame(job, frame, tiles, &holds).await;
        }
        for (pixels, hold) in rendered {
            self.clone().deliver_blob(pixels, hold).await;
        }
    }

    /// Renders a tile; `None` if it was dropped or failed, which is then reported.
    async fn render(&self, job: &Arc<Job>, frame: u32, tile: LeasedTile, hold: &Hold) -> Option<Pixels> {
        if hold.dropped.is_cancelled() {
            return None;
        }
        let (renderer, job, cancel) = (self.renderer.clone(), job.clone(), hold.cancel.clone());
        let rays = tile.rect.pixels() as f64 * f64::from(job.image.samples);
        let start = Instant::now();
        let rendered =
            spawn_blocking(move || renderer.render(&TileRun { job: &job, frame, rect: tile.rect }, &cancel, &|_| {}));
        let message = match rendered.await {
            Ok(Ok(pixels)) => {
                self.tell(Event::Speed(rays / start.elapsed().as_secs_f64().max(1e-6)));
                return Some(pixels);
            }
            Ok(Err(RenderError::Cancelled)) if hold.cancel.is_cancelled() => return None,
            Ok(Err(error)) => chain(&error),
            Err(panic) => panic_message("the renderer", panic),
        };
        tracing::warn!(message, lease = %hold.lease, "a tile could not be rendered");
        self.finish(std::slice::from_ref(hold), &Outcome::Failed { message });
        None
    }
}

/// An error and what caused it, in one line.
pub(super) fn chain(error: &dyn std::error::Error) -> String {
    let mut line = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        line = format!("{line}: {error}");
        cause = error.source();
    }
    line
}

/// What a blocking task said when it fell over.
pub(super) fn panic_message(who: &str, error: JoinError) -> String {
    let Ok(panic) = error.try_into_panic() else { return format!("{who} was stopped") };
    let text = panic_text(&*panic);
    format!("{who} panicked: {text}")
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message")
}
