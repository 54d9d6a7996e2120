//! Cells of a scene on a GPU. A kernel asks for those that its rays need, the host makes them, and the kernel runs again.

use rayon::prelude::*;
use scene::real::Table;

use super::device::{Device, LoadedModule, UploadedTable};
use super::{CudaError, KernelSource};
use crate::cpu::check_cells;
use crate::renderer::CancelFlag;

/// Cells that are made on the host as a kernel asks for them.
#[derive(Debug)]
pub(super) struct Cells {
    table: Table,
    uploaded: UploadedTable,
}

impl Cells {
    /// Copies the cells of a source to the GPU, if it has any.
    pub(super) fn upload(
        device: &Device,
        loaded: &LoadedModule,
        source: &KernelSource,
    ) -> Result<Option<Self>, CudaError> {
        let upload = |table: &Table| Ok(Self { table: table.clone(), uploaded: device.set_table(loaded, table)? });
        source.table.as_ref().map(upload).transpose()
    }

    pub(super) fn table(&self) -> &Table {
        &self.table
    }

    /// Whether launches that have ended asked for cells: their pixels are not those of the picture.
    pub(super) fn has_asked(&self, device: &Device) -> Result<bool, CudaError> {
        device.has_asked(&self.uploaded)
    }

    /// Makes the cells that the launches so far asked for, and copies them to the GPU; returns whether there were any.
    pub(super) fn make_asked(
        &mut self,
        device: &Device,
        loaded: &LoadedModule,
        cancel: &CancelFlag,
    ) -> Result<bool, CudaError> {
        let asked = device.take_asked(&mut self.uploaded)?;
        if asked.is_empty() {
            return Ok(false);
        }
        let make = |&index: &u32| {
            if cancel.is_cancelled() { Err(CudaError::Cancelled) } else { Ok(self.table.make_in_place(index)) }
        };
        let changes = asked.par_iter().with_max_len(1).map(make).collect::<Result<Vec<_>, _>>()?;
        check_cells(Some(&self.table))?;
        device.update_table(loaded, &mut self.uploaded, &self.table, &changes)?;
        tracing::debug!(cells = changes.len(), words = self.table.used(), "made cells");
        Ok(true)
    }
}
