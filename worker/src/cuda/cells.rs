//! Cells of a scene on a GPU. A kernel asks for those that its rays need, others divide them, and the kernel runs again.

use std::time::Instant;

use rayon::prelude::*;
use scene::real::Table;

use super::device::{Device, LoadedModule, UploadedTable};
use super::{CudaError, KernelSource};
use crate::renderer::CancelFlag;

/// Levels of cells that the host divides.
const OUTERMOST_LEVELS: usize = 2;

/// Cells that are divided as a kernel asks for them.
#[derive(Debug)]
pub(super) struct Cells {
    table: Table,
    uploaded: UploadedTable,
}

impl Cells {
    /// Copies the cells of a source to the GPU, if it has any: first only the outermost, whose long lists take a GPU long.
    pub(super) fn upload(
        device: &Device,
        loaded: &LoadedModule,
        source: &KernelSource,
    ) -> Result<Option<Self>, CudaError> {
        let upload = |table: &Table| {
            let start = Instant::now();
            for _ in 0..OUTERMOST_LEVELS {
                table.outermost().par_iter().for_each(|&missing| {
                    table.make(missing);
                });
            }
            tracing::debug!(took = ?start.elapsed(), words = table.used(), "made the outermost cells");
            Ok(Self { table: table.clone(), uploaded: device.set_table(loaded, table)? })
        };
        source.table.as_ref().map(upload).transpose()
    }

    pub(super) fn table(&self) -> &Table {
        &self.table
    }

    /// Whether launches that have ended asked for cells: their pixels are not those of the picture.
    pub(super) fn has_asked(&self, device: &Device) -> Result<bool, CudaError> {
        Ok(device.asked(&self.uploaded)? > 0)
    }

    /// Divides the cells that the launches so far asked for; returns whether there were any.
    pub(super) fn make_asked(
        &mut self,
        device: &Device,
        loaded: &LoadedModule,
        cancel: &CancelFlag,
    ) -> Result<bool, CudaError> {
        let go_on = || if cancel.is_cancelled() { Err(CudaError::Cancelled) } else { Ok(()) };
        let start = Instant::now();
        let cells = device.divide_asked(loaded, &mut self.uploaded, &go_on)?;
        tracing::debug!(cells, words = self.uploaded.used(), took = ?start.elapsed(), "made cells");
        Ok(cells > 0)
    }
}
