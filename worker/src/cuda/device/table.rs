//! Words of a scene in a GPU's memory. Its kernels tell which missing ones they asked for.

#![expect(unsafe_code, reason = "kernels see raw memory")]

use cudarc::driver::{CudaFunction, CudaSlice, DevicePtr, LaunchConfig, PushKernelArg, sys};
use scene::real::Words;

use super::{Device, LoadedModule};
use crate::cuda::CudaError;

/// Least room for words, so that few tables are copied again because they have grown.
const MIN_WORDS: usize = 1 << 20;
/// Threads of a block of `set_words`.
const THREADS: u32 = 256;

/// A table in the GPU's memory, with room for more words.
#[derive(Debug)]
pub(in crate::cuda) struct UploadedTable {
    words: CudaSlice<u32>,
    /// `asked` of kernel.cu.
    asked: CudaSlice<u32>,
    /// Number of words that have been copied.
    used: usize,
    set_words: CudaFunction,
}

fn copy_error(bytes: usize) -> impl FnOnce(cudarc::driver::DriverError) -> CudaError {
    move |error| match error.0 {
        sys::CUresult::CUDA_ERROR_OUT_OF_MEMORY => CudaError::OutOfMemory { bytes },
        _ => CudaError::driver_error("copy the scene's cells to the GPU")(error),
    }
}

impl Device {
    /// Copies a table to the GPU and gives it to a kernel. It must live until the last launch that reads it has ended;
    /// its memory is freed after the launches before its end.
    pub(in crate::cuda) fn set_table(&self, program: &LoadedModule, table: &Words) -> Result<UploadedTable, CudaError> {
        let present = table.after(0);
        let room = (present.len() + present.len() / 2).max(MIN_WORDS);
        let copy = || {
            // SAFETY: kernels read no words beyond those that are copied here.
            let mut words = unsafe { self.compute.alloc::<u32>(room) }?;
            self.compute.memcpy_htod(&present, &mut words.slice_mut(..present.len()))?;
            let asked = self.compute.alloc_zeros(1 + room.div_ceil(32))?;
            let set_words = program.module.load_function("set_words")?;
            Ok(UploadedTable { words, asked, used: present.len(), set_words })
        };
        let uploaded = copy().map_err(copy_error(room * size_of::<u32>()))?;
        for (name, memory) in [("table", &uploaded.words), ("asked", &uploaded.asked)] {
            self.set_global(program, name, &memory.device_ptr(&self.compute).0.to_ne_bytes())?;
        }
        Ok(uploaded)
    }

    /// Whether a launch that has ended asked for missing words.
    pub(in crate::cuda) fn has_asked(&self, table: &UploadedTable) -> Result<bool, CudaError> {
        let look = || {
            let mut first = [0];
            self.copies.memcpy_dtoh(&table.asked.slice(..1), &mut first[..])?;
            self.copies.synchronize().map(|()| first != [0])
        };
        look().map_err(CudaError::driver_error("read from the GPU which cells it needs"))
    }

    /// Indices of the missing words that were asked for since the last call, after all launches so far.
    pub(in crate::cuda) fn take_asked(&self, table: &mut UploadedTable) -> Result<Vec<u32>, CudaError> {
        let mut take = || {
            let mut bits = self.compute.clone_dtoh(&table.asked.slice(1..=table.used.div_ceil(32)))?;
            self.compute.memset_zeros(&mut table.asked)?;
            self.compute.synchronize()?;
            let mut indices = Vec::new();
            for (first, bits) in (0..).step_by(32).zip(&mut bits) {
                while *bits != 0 {
                    indices.push(first + bits.trailing_zeros());
                    *bits &= *bits - 1;
                }
            }
            Ok(indices)
        };
        take().map_err(CudaError::driver_error("read from the GPU which cells it needs"))
    }

    /// Copies the words that have been appended since the last copy, and changes some before them, given as index and
    /// word. No launch may be running.
    pub(in crate::cuda) fn update_table(
        &self,
        program: &LoadedModule,
        uploaded: &mut UploadedTable,
        table: &Words,
        changes: &[(u32, u32)],
    ) -> Result<(), CudaError> {
        let appended = table.after(uploaded.used);
        let used = uploaded.used + appended.len();
        if used > uploaded.words.len() {
            *uploaded = self.set_table(program, table)?;
            return Ok(());
        }
        let pairs: Vec<u32> = changes.iter().flat_map(|&(index, word)| [index, word]).collect();
        let count = changes.len() as u32;
        let mut copy = || {
            self.compute.memcpy_htod(&appended, &mut uploaded.words.slice_mut(uploaded.used..used))?;
            let pairs = self.compute.clone_htod(&pairs)?;
            let config = LaunchConfig {
                grid_dim: (count.div_ceil(THREADS), 1, 1),
                block_dim: (THREADS, 1, 1),
                shared_mem_bytes: 0,
            };
            let mut set_words = self.compute.launch_builder(&uploaded.set_words);
            set_words.arg(&mut uploaded.words).arg(&pairs).arg(&count);
            // SAFETY: the arguments match those of `set_words` in kernel.cu in number, order and type. The changed words
            // are among those that were copied before.
            unsafe { set_words.launch(config) }.map(|_| ())
        };
        copy().map_err(copy_error(appended.len() * size_of::<u32>()))?;
        uploaded.used = used;
        Ok(())
    }
}
