//! The launches that render some tiles, and the copies of their pixels.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::TryLockError;

use proto::Rect;
use rayon::prelude::*;
use scene::ImageSpec;
use scene::real::Table;

use super::active_blocks::{ActiveBlocks, FinishedTile};
use super::cells::{Cells, Made};
use super::device::{Buffer, Device, LaunchRange, PendingLaunch, SavedPixels};
use super::launches::{self, Ends, Launches, Piece};
use super::source::{batches_plane, device_planes};
use super::{CudaError, CudaRenderer, Kernel, KernelSource, KernelState, lock};
use crate::renderer::{CancelFlag, RenderError, TilePixels, TileRequest};
use crate::rounds::Rounds;

/// Maximum size of pixel buffers on the GPU or being copied, in numbers.
const BUFFER_FLOATS: usize = 64 << 20;

/// The samples of a round at an instant of a frame, and its kernel.
struct Instant<'a> {
    program: &'a Kernel,
    source: &'a KernelSource,
    samples: Range<u32>,
    ends: Ends,
}

/// A launch in progress.
struct Flying {
    part: LaunchRange,
    /// The sums before it, if it may have to be repeated.
    sums: Option<SavedPixels>,
    launched: PendingLaunch,
}

/// Tiles whose pixels are being copied to the host.
struct InFlight {
    rects: Vec<Rect>,
    buffer: Buffer,
    /// The tiles with the host's additions, if their samples were taken in rounds.
    finished: Option<Vec<FinishedTile>>,
}

impl CudaRenderer {
    /// Renders tiles, as many at a time as the buffers hold; one group is copied while the next renders. Calls
    /// `on_device_free` once the last group has been rendered and its copy has been started.
    pub(super) fn render_groups(
        &self,
        runs: &[TileRequest<'_>],
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
        on_device_free: &mut dyn FnMut(),
        finished: &mut Vec<TilePixels>,
    ) -> Result<(), CudaError> {
        let Some(first) = runs.first() else { return Ok(()) };
        let sources = self.sources(first, cancel)?;
        let planes = device_planes(&first.job.image);
        let numbers = |run: &TileRequest<'_>| run.rect.pixels() as usize * planes;
        let mut underway: Option<InFlight> = None;
        let mut rest = runs;
        let mut most = BUFFER_FLOATS;
        while !rest.is_empty() {
            let mut total = 0;
            let fitting = rest.iter().take_while(|run| {
                total += numbers(run);
                total <= most
            });
            let (group, others) = rest.split_at(fitting.count().max(1));
            let next = self.enqueue(&sources, group, cancel);
            if let Some(before) = underway.take() {
                finished.extend(self.collect(before, &first.job.image, progress)?);
            }
            if group.len() > 1 && matches!(next, Err(CudaError::OutOfMemory { .. })) {
                // Tiles that do not fit in memory together may fit one after another.
                most = group.iter().map(numbers).sum::<usize>() / 2;
                continue;
            }
            underway = Some(next?);
            rest = others;
        }
        on_device_free();
        if let Some(last) = underway {
            finished.extend(self.collect(last, &first.job.image, progress)?);
        }
        Ok(())
    }

    /// Launches the render of some tiles and the copy of their pixels.
    fn enqueue(
        &self,
        sources: &[KernelSource],
        runs: &[TileRequest<'_>],
        cancel: &CancelFlag,
    ) -> Result<InFlight, CudaError> {
        let image = &runs[0].job.image;
        let rects: Vec<Rect> = runs.iter().map(|run| run.rect).collect();
        let planes = device_planes(image);
        let numbers = rects.iter().map(|rect| rect.pixels() as usize).sum::<usize>() * planes;
        let _launching = lock(&self.launching);
        let mut buffer = self.take_buffer(numbers)?;
        let mut blocks = Rounds::of(image).map(|rules| ActiveBlocks::new(rules, &rects, planes, batches_plane(image)));
        let mut pieces = launches::whole(&rects, planes);
        for round in 0..sources[0].samples.len() {
            for (index, source) in sources.iter().enumerate() {
                let (program, _) = self.program(source, &runs[runs.len() / 2], cancel)?;
                let is_last = index + 1 == sources.len();
                let ends = Ends { mean: is_last && blocks.is_none(), layers: is_last && round == 0 };
                let samples = source.samples[round].clone();
                let instant = Instant { program: &program, source, samples, ends };
                self.launch_instant(&instant, &pieces, &mut buffer, cancel)?;
                if cancel.is_cancelled() {
                    lock(&self.buffers).push(buffer);
                    return Err(CudaError::Cancelled);
                }
            }
            let Some(blocks) = &mut blocks else { continue };
            self.device.start_copy(&mut buffer, numbers)?;
            let end = sources.last().map_or(0, |last| last.samples[round].end);
            blocks.end_round(round, end, Device::wait_copy(&buffer)?);
            pieces = blocks.pieces();
            if pieces.is_empty() {
                break;
            }
        }
        let finished = blocks.map(ActiveBlocks::finish);
        if finished.is_none() {
            self.device.start_copy(&mut buffer, numbers)?;
        }
        Ok(InFlight { rects, buffer, finished })
    }

    /// Adds the samples of an instant to the pixels of some tiles.
    fn launch_instant(
        &self,
        instant: &Instant<'_>,
        pieces: &[Piece],
        buffer: &mut Buffer,
        cancel: &CancelFlag,
    ) -> Result<(), CudaError> {
        let Instant { program, source, samples, ends } = instant;
        let mut known = lock(&program.known);
        let KernelState { cost, parameters, cells } = &mut *known;
        if parameters.take().is_none_or(|given| given != source.parameters) {
            self.device.set_uniforms(&program.loaded, &source.parameters)?;
        }
        *parameters = Some(source.parameters.clone());
        let of_source = source.table.as_ref().map(Table::as_ptr);
        // Frames whose shapes do not move share cells.
        if cells.as_ref().map(|cells| Table::as_ptr(cells.table())) != of_source {
            // The launches before read the table that is replaced: its memory is freed after them.
            *cells = None;
            *cells = Cells::upload(&self.device, &program.loaded, source, cancel)?;
        }
        let layout = launches::lay_out(pieces, program.block).ordered(cost, samples.len() as u32);
        let laid_out = self.device.lay_out(&layout)?;
        let wave = self.device.multiprocessors * (2048 / program.loaded.threads(program.block));
        let mut launches = Launches::new(layout.blocks, samples.clone(), *ends, wave, source.together);
        // Sums before the samples, for launches that are repeated from the start because cells had no room.
        let before = (samples.start > 0 && cells.is_some()).then(|| self.device.copied(buffer)).transpose()?;
        // First block of the launches for which the cells were made from the start.
        let mut cells_from = None;
        let mut flying: VecDeque<Flying> = VecDeque::new();
        loop {
            let part = if cancel.is_cancelled() { None } else { launches.next(cost) };
            if let Some(part) = part {
                // A launch that asks for cells is repeated: without its samples in the sums.
                let sums =
                    (cells.is_some() && part.first_sample > 0).then(|| self.device.copied(buffer)).transpose()?;
                let launched = self.device.launch(&program.loaded, program.block, &laid_out, part, buffer)?;
                flying.push_back(Flying { part, sums, launched });
            }
            // One launch runs while the next is queued.
            if flying.len() == 2 || part.is_none() {
                let Some(Flying { part, sums, launched }) = flying.pop_front() else { return Ok(()) };
                let ms = launched.wait()?;
                tracing::trace!(?part, ms, "rendered");
                lock(&self.kernels).add(ms);
                let has_asked = cells.as_ref().map(|cells| cells.has_asked(&self.device)).transpose()?;
                let Some(asking) = cells.as_mut().filter(|_| has_asked == Some(true)) else {
                    cost.observe(part, ms);
                    continue;
                };
                for Flying { launched, .. } in flying.drain(..) {
                    lock(&self.kernels).add(launched.wait()?);
                }
                if asking.make_asked(&self.device, &program.loaded, cancel)? != Made::NotAll {
                    if let Some(sums) = &sums {
                        self.device.restore(buffer, sums)?;
                    }
                    launches.repeat(part);
                    continue;
                }
                // Without the earlier launches' cells, there may be room; if not, for fewer blocks.
                let first_block = match &before {
                    Some(before) => {
                        self.device.restore(buffer, before)?;
                        0
                    }
                    None => part.first_block,
                };
                launches.restart(first_block);
                if cells_from.replace(first_block) == Some(first_block) {
                    if part.blocks == 1 {
                        return Err(RenderError::many_cells(asking.table()).into());
                    }
                    launches.limit(part.blocks / 2);
                }
                tracing::debug!(?part, "the cells had no room: drop them");
                *cells = None;
                *cells = Cells::upload(&self.device, &program.loaded, source, cancel)?;
            }
        }
    }

    /// Waits for pixels and returns them.
    fn collect(
        &self,
        underway: InFlight,
        image: &ImageSpec,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<TilePixels>, CudaError> {
        let InFlight { rects, buffer, finished } = underway;
        let (planes, rendered) = (device_planes(image), image.film().rendered_channels().len());
        let mut rest = Device::wait_copy(&buffer)?;
        let mut additions = finished.map(Vec::into_iter);
        let parts: Vec<(Rect, &[f32], Option<FinishedTile>)> = rects
            .into_iter()
            .map(|rect| {
                let (own, others) = rest.split_at(rect.pixels() as usize * planes);
                rest = others;
                (rect, own, additions.as_mut().and_then(Iterator::next))
            })
            .collect();
        // While the next tiles render, nothing waits for these but encoding, which needs the other cores.
        let is_overlapped = matches!(self.launching.try_lock(), Err(TryLockError::WouldBlock));
        let arrange = |(rect, numbers, addition): (Rect, &[f32], Option<FinishedTile>)| {
            let length = rect.pixels() as usize;
            let mut planes: Vec<Vec<f32>> = if is_overlapped {
                numbers.chunks(length).map(|plane| self.copy_plane(plane)).collect()
            } else {
                numbers.par_chunks(length).map(|plane| self.copy_plane(plane)).collect()
            };
            if let Some(addition) = addition {
                addition.finish(&mut planes);
            }
            planes.truncate(rendered);
            progress(rect.pixels() * u64::from(image.samples.max()));
            TilePixels { rect, planes }
        };
        let finished = if is_overlapped {
            parts.into_iter().map(arrange).collect()
        } else {
            parts.into_par_iter().map(arrange).collect()
        };
        lock(&self.buffers).push(buffer);
        Ok(finished)
    }

    /// Returns a buffer that is large enough; smaller ones are freed.
    fn take_buffer(&self, numbers: usize) -> Result<Buffer, CudaError> {
        let mut buffers = lock(&self.buffers);
        buffers.retain(|buffer| buffer.floats() >= numbers);
        match buffers.pop() {
            Some(buffer) => Ok(buffer),
            None => self.device.buffer(numbers),
        }
    }

    /// Copies a plane, into reused memory if possible, because new memory costs more than the copy.
    fn copy_plane(&self, plane: &[f32]) -> Vec<f32> {
        let spare = {
            let mut spare = lock(&self.spare);
            let place = spare.iter().position(|old| old.capacity() >= plane.len());
            place.map(|place| spare.swap_remove(place))
        };
        let mut copy = spare.unwrap_or_default();
        copy.clear();
        copy.extend_from_slice(plane);
        copy
    }
}
