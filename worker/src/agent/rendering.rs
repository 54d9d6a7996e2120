//! Renders batches: sends tiles to the device, as many at a time as the renderer prefers, and delivers finished
//! ones while the next render. Leases and the server are known here only as receivers of results.

use std::pin::pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use proto::fail_point::{self, FailPoint};
use proto::worker_protocol::{LeaseOutcome, Phase};
use proto::{JobId, Rect};
use scene::Job;
use tokio::sync::{SemaphorePermit, oneshot};
use tokio::task::{JoinError, JoinSet, spawn_blocking};
use tracing::Instrument;

use super::changes::{Record, Recorded};
use super::device_use::{DeviceUse, SharedTime};
use super::executor::{
    BatchEvent, BatchExecutor, CancelOnDrop, FrameTask, LeaseHandle, MEMORY_KIB, all_dropped, chain, panic_message,
};
use crate::renderer::{CancelFlag, RenderError, TilePixels, TileRequest, chunk_length};

/// How long a cancelled render may take to stop. A renderer notices within 50 ms, unless it hangs.
const STOP_TIMEOUT: Duration = Duration::from_millis(1500);
/// Maximum memory of the tiles of one batch that are rendered and not yet delivered.
const MAX_BATCH_KIB: u64 = 512 << 10;

/// Tile to render, with its lease.
#[derive(Clone, Debug)]
pub(super) struct TileTask {
    /// Its pixels.
    pub(super) rect: Rect,
    /// Lease of the tile.
    pub(super) hold: LeaseHandle,
}

/// A finished tile.
#[derive(Debug)]
pub(super) struct Rendered {
    /// Its pixels.
    pub(super) pixels: TilePixels,
    /// Lease of the tile.
    pub(super) hold: LeaseHandle,
    /// Record of what its rays asked for.
    pub(super) record: Option<Record>,
}

/// Outcome of giving tiles to the device.
enum RenderOutcome {
    Pixels(Vec<Recorded>),
    /// All leases of the tiles were dropped.
    Dropped,
    /// The device failed, or a time limit has passed.
    Refused(String),
    /// The render does not stop after its leases were dropped, or after its time limit has passed with this message.
    Stuck(Option<String>),
}

impl BatchExecutor {
    /// Renders tiles, each delivered as a blob while the next ones render.
    pub(super) async fn render_tiles(self: &Arc<Self>, frame: FrameTask, places: Vec<TileTask>) {
        let places = &self.keep_unchanged(&frame, places).await[..];
        if places.is_empty() {
            return self.send(BatchEvent::Rendered { took: None, frame_of: None });
        }
        let memory = self.reserve(&frame.job, places).await;
        let mut stage = Some(self.device.stage().await);
        let mut device = self.prepared(&frame, places, None).await;
        let mut deliveries = JoinSet::new();
        let mut chunks = self.chunks(&frame.job, places).peekable();
        while let Some(chunk) = chunks.next() {
            let is_last = chunks.peek().is_none();
            let rendered = self.render_chunk(&frame, chunk, &mut device, is_last).await;
            if is_last {
                device.release();
                stage = None;
            }
            for rendered in rendered {
                while deliveries.len() >= self.max_uploads() {
                    deliveries.join_next().await;
                }
                let span = tracing::info_span!("tile", tile = rendered.hold.tile);
                deliveries.spawn(self.clone().upload_blob(rendered).instrument(span));
            }
        }
        debug_assert!(stage.is_none(), "a batch has a tile");
        let render_ms = milliseconds(device.elapsed());
        while deliveries.join_next().await.is_some() {}
        let total_ms = milliseconds(device.elapsed());
        tracing::debug!(job = %frame.id, frame = frame.number, tiles = places.len(), render_ms, total_ms, "tiles rendered");
        drop(memory);
    }

    /// Renders a whole frame and delivers its picture. If some tile failed or was dropped,
    /// the others are delivered as blobs.
    pub(super) async fn render_whole(self: &Arc<Self>, frame: FrameTask, places: &[TileTask]) {
        let memory = self.reserve(&frame.job, places).await;
        let stage = self.device.stage().await;
        let mut device = self.prepared(&frame, places, Some(frame.id)).await;
        let mut rendered = Vec::with_capacity(places.len());
        let mut chunks = self.chunks(&frame.job, places).peekable();
        while let Some(chunk) = chunks.next() {
            rendered.extend(self.render_chunk(&frame, chunk, &mut device, chunks.peek().is_none()).await);
        }
        device.release();
        drop(stage);
        let render = device.elapsed();
        if rendered.len() == places.len() {
            self.upload_frame(&frame, rendered, render).await;
        } else {
            for rendered in rendered {
                let span = tracing::info_span!("tile", tile = rendered.hold.tile);
                self.clone().upload_blob(rendered).instrument(span).await;
            }
        }
        drop(memory);
    }

    /// Waits for the device, while the batch's frame is prepared for it.
    async fn prepared(&self, frame: &FrameTask, places: &[TileTask], frame_of: Option<JobId>) -> DeviceUse<'_> {
        let holds: Vec<LeaseHandle> = places.iter().map(|place| place.hold.clone()).collect();
        if self.renderer.overlapping() > 1
            && let Some(TileTask { rect, .. }) = places.first()
        {
            let (renderer, job, number, rect) = (self.renderer.clone(), frame.job.clone(), frame.number, *rect);
            // Cancels the preparation when all leases are dropped.
            let cancel = CancelOnDrop::default();
            let flag = cancel.0.clone();
            let prepare = move || renderer.prepare(&TileRequest { job: &job, frame: number, rect }, &flag);
            tokio::select! {
                prepared = spawn_blocking(prepare) => if let Ok(Err(error)) = prepared {
                    // The render fails for the same reason, and reports it.
                    tracing::debug!(%error, "could not prepare a frame");
                },
                () = all_dropped(&holds) => {}
            }
        }
        let mut device = DeviceUse::new(self, frame_of);
        tokio::select! {
            () = device.acquire() => holds.iter().take(1).for_each(|hold| self.send(BatchEvent::Begins(hold.lease))),
            // Nothing will be rendered.
            () = all_dropped(&holds) => {}
        }
        device
    }

    /// Waits until there is memory for a batch's pixels.
    async fn reserve(&self, job: &Job, places: &[TileTask]) -> SemaphorePermit<'_> {
        let pixels: u64 = places.iter().map(|place| place.rect.pixels()).sum();
        let kib = (pixels * u64::from(job.image.film().pixel_bytes())).div_ceil(1 << 10).min(MAX_BATCH_KIB);
        let kib = u32::try_from(kib).expect("it is at most that").min(MEMORY_KIB);
        self.memory.acquire_many(kib).await.expect("the semaphore is never closed")
    }

    fn chunks<'a>(&self, job: &Job, places: &'a [TileTask]) -> std::slice::Chunks<'a, TileTask> {
        places.chunks(chunk_length(&*self.renderer, job, places.iter().map(|place| place.rect)))
    }

    /// Renders tiles together, without those that were dropped or failed; failures are reported. After the last tiles,
    /// the device is released as early as possible.
    async fn render_chunk(
        &self,
        frame: &FrameTask,
        chunk: &[TileTask],
        device: &mut DeviceUse<'_>,
        is_last: bool,
    ) -> Vec<Rendered> {
        let wanted: Vec<TileTask> = chunk.iter().filter(|place| !place.hold.dropped.is_cancelled()).cloned().collect();
        if wanted.is_empty() || self.report_if_device_lost() {
            return Vec::new();
        }
        let span = tracing::info_span!("render", tile = wanted[0].hold.tile, tiles = wanted.len());
        let message = match self.launch(frame, &wanted, device, is_last).instrument(span).await {
            RenderOutcome::Pixels(pixels) => {
                let pairs = pixels.into_iter().zip(wanted);
                let rendered = |(Recorded { pixels, visited }, TileTask { hold, .. })| Rendered {
                    pixels,
                    hold,
                    record: visited.map(|visited| Record::of_rendered(&visited)),
                };
                return pairs.map(rendered).collect();
            }
            RenderOutcome::Dropped => return Vec::new(),
            RenderOutcome::Refused(message) => message,
            RenderOutcome::Stuck(message) => {
                if let Some(message) = message {
                    self.finish(wanted.iter().map(|place| &place.hold), &LeaseOutcome::Failed { message });
                }
                self.send(BatchEvent::Stuck(format!("the renderer did not stop within {STOP_TIMEOUT:?}")));
                // This process is ending; the device stays occupied until then.
                return std::future::pending().await;
            }
        };
        if self.report_if_device_lost() {
            return Vec::new();
        }
        let [TileTask { hold, .. }] = &wanted[..] else {
            // Rendering each tile alone shows which one causes the error.
            tracing::debug!(message, tiles = wanted.len(), "could not render tiles together; rendering each alone");
            let mut rendered = Vec::with_capacity(wanted.len());
            for place in wanted.chunks(1) {
                rendered.extend(Box::pin(self.render_chunk(frame, place, device, false)).await);
            }
            return rendered;
        };
        tracing::warn!(message, tile = hold.tile, lease = %hold.lease, "could not render a tile");
        self.finish([hold], &LeaseOutcome::Failed { message });
        Vec::new()
    }

    /// Whether the device is lost; if so, reports it to the session.
    fn report_if_device_lost(&self) -> bool {
        let Some(reason) = self.renderer.lost_reason() else { return false };
        self.send(BatchEvent::DeviceLost(reason));
        true
    }

    /// Gives tiles to the device until all their leases are dropped. After a batch's last tiles, the device is released
    /// as soon as another render may start.
    async fn launch(
        &self,
        frame: &FrameTask,
        places: &[TileTask],
        device: &mut DeviceUse<'_>,
        is_last: bool,
    ) -> RenderOutcome {
        device.acquire().await;
        let (rects, holds): (Vec<Rect>, Vec<LeaseHandle>) =
            places.iter().map(|TileTask { rect, hold }| (*rect, hold.clone())).unzip();
        let rays =
            rects.iter().map(|rect| rect.pixels()).sum::<u64>() as f64 * f64::from(frame.job.image.samples.max());
        let stop = CancelOnDrop::default();
        let (renderer, job, number, cancel) = (self.renderer.clone(), frame.job.clone(), frame.number, stop.0.clone());
        let records = frame.recording.is_some() && renderer.can_record();
        let start = Instant::now();
        let (free, mut freed) = oneshot::channel();
        let mut free = Some(free).filter(|_| is_last);
        let mut on_device_free = move || {
            if let Some(free) = free.take() {
                // Without a receiver the render was dropped, and its end frees the device.
                free.send(start.elapsed()).unwrap_or_default();
            }
        };
        let mut rendering = spawn_blocking(move || {
            fail_point::trigger_infallible(FailPoint::Rendering);
            let runs: Vec<TileRequest<'_>> =
                rects.iter().map(|&rect| TileRequest { job: &job, frame: number, rect }).collect();
            if records {
                let recorded = |run| renderer.render_recorded(run, &cancel, &|_| {});
                return runs.iter().map(|run| Ok(Recorded::from(recorded(run)?))).collect();
            }
            let rendered = renderer.render_overlapped(&runs, &cancel, &|_| {}, &mut on_device_free)?;
            assert_eq!(rendered.len(), runs.len(), "a renderer renders all tiles or none");
            Ok(rendered.into_iter().map(|pixels| Recorded::from((pixels, None))).collect())
        });
        let (mut dropped, mut limit) =
            (pin!(all_dropped(&holds)), pin!(over_limit(frame.tile_seconds, &self.shared_time)));
        let mut on_device = None;
        let over_limit = loop {
            tokio::select! {
                rendered = &mut rendering => {
                    let spent = on_device.or(freed.try_recv().ok()).unwrap_or_else(|| start.elapsed());
                    return self.outcome(rendered, rays, spent, &stop.0, None);
                }
                Ok(spent) = &mut freed, if on_device.is_none() => {
                    on_device = Some(spent);
                    device.release();
                }
                () = &mut dropped => break None,
                message = &mut limit => break Some(message),
            }
        };
        stop.0.cancel();
        match tokio::time::timeout(STOP_TIMEOUT, rendering).await {
            Ok(rendered) => {
                self.outcome(rendered, rays, on_device.unwrap_or_else(|| start.elapsed()), &stop.0, over_limit)
            }
            Err(_) => RenderOutcome::Stuck(over_limit),
        }
    }

    /// Outcome of a render that has ended and `spent` this time on the device, and reports its speed. A cancelled one was
    /// over its limit, with this message, or its leases were dropped.
    fn outcome(
        &self,
        rendered: Result<Result<Vec<Recorded>, RenderError>, JoinError>,
        rays: f64,
        spent: Duration,
        stop: &CancelFlag,
        over_limit: Option<String>,
    ) -> RenderOutcome {
        match rendered {
            Ok(Ok(pixels)) => {
                let spent = spent.saturating_sub(self.renderer.take_setup_time());
                self.send(BatchEvent::Speed { rays, seconds: spent.as_secs_f64().max(1e-6) });
                self.send(BatchEvent::Timed { phase: Phase::Render, took: spent, rays: rays as u64 });
                RenderOutcome::Pixels(pixels)
            }
            Ok(Err(RenderError::Cancelled)) if stop.is_cancelled() => {
                over_limit.map_or(RenderOutcome::Dropped, RenderOutcome::Refused)
            }
            Ok(Err(error)) => RenderOutcome::Refused(chain(&error)),
            Err(panic) => RenderOutcome::Refused(panic_message("the renderer", panic)),
        }
    }
}

/// Waits until the time limit of a tile has passed, without the time in which it shared the device; returns the message of
/// its failure.
async fn over_limit(tile_seconds: Option<u32>, shared: &SharedTime) -> String {
    let Some(limit) = tile_seconds else { return std::future::pending().await };
    let (start, shared_before) = (Instant::now(), shared.total());
    loop {
        let used = start.elapsed().saturating_sub(shared.total().saturating_sub(shared_before));
        let left = Duration::from_secs(limit.into()).saturating_sub(used);
        if left.is_zero() {
            break;
        }
        tokio::time::sleep(left).await;
    }
    format!(
        "rendering a tile took longer than its limit of {limit} s: use fewer samples or a simpler scene, smaller tiles \
         (`sdfarm serve --tile`), or a higher limit (`sdfarm submit --tile-seconds`, at most that of `sdfarm serve \
         --max-tile-seconds`)"
    )
}

/// Milliseconds of a duration, for logs.
pub(super) fn milliseconds(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e4).round() / 10.0
}
