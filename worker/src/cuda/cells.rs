//! Cells of a scene on a GPU. A kernel asks for those that its rays need, others divide them, and the kernel runs again.

use std::time::Instant;

use rayon::prelude::*;
use scene::real::Table;

use super::device::{Device, LoadedModule, UploadedTable};
use super::{CudaError, KernelSource};
use crate::renderer::{CancelFlag, RenderError};

/// Cells that are divided as a kernel asks for them.
#[derive(Debug)]
pub(super) struct Cells {
    table: Table,
    uploaded: UploadedTable,
}

/// Result of dividing the cells that kernels asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Made {
    /// They asked for none.
    Nothing,
    /// All were divided.
    All,
    /// Not all had room.
    NotAll,
}

fn go_on(cancel: &CancelFlag) -> Result<(), CudaError> {
    if cancel.is_cancelled() { Err(CudaError::Cancelled) } else { Ok(()) }
}

impl Cells {
    /// Copies the cells of a source to the GPU, if it has any: only the outermost, whose long lists take a GPU long. They
    /// are made first, unless that is cancelled.
    pub(super) fn upload(
        device: &Device,
        loaded: &LoadedModule,
        source: &KernelSource,
        cancel: &CancelFlag,
    ) -> Result<Option<Self>, CudaError> {
        let upload = |table: &Table| {
            let start = Instant::now();
            loop {
                let outermost = table.outermost();
                if outermost.is_empty() {
                    break;
                }
                outermost.par_iter().try_for_each(|&missing| {
                    go_on(cancel).map(|()| {
                        table.make(missing);
                    })
                })?;
            }
            if table.is_full() {
                return Err(RenderError::many_cells(table).into());
            }
            tracing::debug!(took = ?start.elapsed(), words = table.used(), "made the outermost cells");
            Ok(Self { table: table.clone(), uploaded: device.set_table(loaded, table)? })
        };
        source.table.as_ref().map(upload).transpose()
    }

    pub(super) fn table(&self) -> &Table {
        &self.table
    }

    /// Whether launches that have ended asked for cells: their pixels are not the picture's.
    pub(super) fn has_asked(&self, device: &Device) -> Result<bool, CudaError> {
        Ok(device.asked(&self.uploaded)? > 0)
    }

    /// Divides the cells that the launches so far asked for.
    pub(super) fn make_asked(
        &mut self,
        device: &Device,
        loaded: &LoadedModule,
        cancel: &CancelFlag,
    ) -> Result<Made, CudaError> {
        let start = Instant::now();
        let made = device.divide_asked(loaded, &mut self.uploaded, &|| go_on(cancel))?;
        tracing::debug!(?made, words = self.uploaded.used(), took = ?start.elapsed(), "made cells");
        Ok(made)
    }
}
