//! Words of a scene in a GPU's memory, whose cells are divided there when a kernel asks for them.

#![expect(unsafe_code, reason = "kernels see raw memory")]

use std::sync::Arc;

use cudarc::driver::{CudaFunction, CudaSlice, DevicePtr, DeviceRepr, LaunchConfig, PushKernelArg, sys};
use cudarc::nvrtc::Ptx;
use scene::cells::{BLOCK_CELLS, Division};
use scene::real::Words;
use scene::real::list::OPERATION_WORDS;

use super::{Device, LoadedModule};
use crate::cuda::CudaError;
use crate::cuda::cells::Made;

/// Least room for words, so that few tables are copied because they have grown.
const MIN_WORDS: usize = 1 << 20;
/// Words of a block: its cells, and the index of their list.
const BLOCK_WORDS: usize = BLOCK_CELLS as usize + 1;
/// Threads of a block of the kernels that divide cells.
const THREADS: u32 = 128;
/// Words of `asked` before the indices: their number, and the room for them.
const ASKED_HEAD: usize = 2;
/// Maximum number of cells that kernels may ask for at a time. Those beyond are asked for again.
const MAX_ASKED: usize = 1 << 18;
/// Words of `asked` before the bits.
const BITS: usize = ASKED_HEAD + 2 * MAX_ASKED;
/// Numbers of scratch memory, unless a single list needs more.
const SCRATCH_NUMBERS: usize = 1 << 28;

/// A table in the GPU's memory, with room for more words.
#[derive(Debug)]
pub(in crate::cuda) struct UploadedTable {
    words: CudaSlice<u32>,
    /// Number of words that exist, and that may exist.
    used: usize,
    limit: usize,
    /// `asked` of kernel.cu.
    asked: CudaSlice<u32>,
    /// `None` if all cells exist.
    division: Option<UploadedDivision>,
}

impl UploadedTable {
    /// Number of words that exist.
    pub(in crate::cuda) fn used(&self) -> usize {
        self.used
    }
}

/// The rules by which cells are divided, with memory for that.
#[derive(Debug)]
struct UploadedDivision {
    rules: Rules,
    factors: CudaSlice<f32>,
    boxes: CudaSlice<f32>,
    joins: CudaSlice<f32>,
    first_boxes: CudaSlice<u32>,
    /// Number of words that are used, and whether there was no room for some.
    state: CudaSlice<u32>,
    scratch: CudaSlice<f32>,
    measure: CudaFunction,
    kernels: Arc<DivisionKernels>,
}

/// Kernels of divide.cu.
#[derive(Debug)]
pub(in crate::cuda) struct DivisionKernels {
    divide: CudaFunction,
    publish: CudaFunction,
}

/// `Division` of cells.cu.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct DivisionArguments {
    words: u64,
    state: u64,
    missing: u64,
    factors: u64,
    boxes: u64,
    joins: u64,
    first_boxes: u64,
    scratch: u64,
    cells: u32,
    first_block: u32,
    longest: u32,
    capacity: u32,
    rules: Rules,
}

/// `Rules` of cells.cu.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Rules {
    center: [f32; 3],
    unit: f32,
    shorter: f32,
    levels: u32,
    coarse_levels: u32,
    leaf_lists: u32,
    short_list: u32,
    max_stalls: u32,
}

// SAFETY: it is plain numbers, in C's order and with C's padding.
unsafe impl DeviceRepr for DivisionArguments {}

fn copy_error(bytes: usize) -> impl Fn(cudarc::driver::DriverError) -> CudaError {
    move |error| match error.0 {
        sys::CUresult::CUDA_ERROR_OUT_OF_MEMORY => CudaError::OutOfMemory { bytes },
        _ => CudaError::driver_error("make the scene's cells on the GPU")(error),
    }
}

/// Numbers of scratch memory for a cell whose list has this many operations.
fn scratch_of(operations: usize) -> usize {
    BLOCK_CELLS as usize * (5 * operations + operations.div_ceil(32))
}

impl Device {
    /// Copies a table to the GPU and gives it to a kernel. It must live until the last launch that reads it has ended;
    /// its memory is freed after the launches before its end.
    pub(in crate::cuda) fn set_table(&self, program: &LoadedModule, table: &Words) -> Result<UploadedTable, CudaError> {
        let present = table.after(0);
        let room = (present.len() + present.len() / 2).max(MIN_WORDS).min(table.capacity());
        let copy = || {
            // SAFETY: kernels read no words beyond those that are copied here, or that they have written.
            let mut words = unsafe { self.compute.alloc::<u32>(room) }?;
            self.compute.memcpy_htod(&present, &mut words.slice_mut(..present.len()))?;
            let division = table.division().zip(program.division.clone());
            let division =
                division.map(|(division, kernels)| self.upload_division(program, division, kernels)).transpose()?;
            Ok(UploadedTable {
                words,
                used: present.len(),
                limit: table.capacity(),
                asked: self.new_asked(room)?,
                division,
            })
        };
        let uploaded = copy().map_err(copy_error(room * size_of::<u32>()))?;
        self.set_pointers(program, &uploaded)?;
        Ok(uploaded)
    }

    /// Loads the kernels that divide cells.
    pub(in crate::cuda) fn load_division(&self, code: &[u8]) -> Result<DivisionKernels, CudaError> {
        let load = || {
            let module = self.context.load_module(Ptx::from_binary(code.to_vec()))?;
            Ok(DivisionKernels { divide: module.load_function("divide")?, publish: module.load_function("publish")? })
        };
        load().map_err(CudaError::driver_error("load the kernels that divide cells"))
    }

    /// Memory for what kernels ask for, in a table with this much room.
    fn new_asked(&self, room: usize) -> Result<CudaSlice<u32>, cudarc::driver::DriverError> {
        let mut asked = self.compute.alloc_zeros(BITS + room.div_ceil(32))?;
        self.compute.memcpy_htod(&[0, MAX_ASKED as u32], &mut asked.slice_mut(..ASKED_HEAD))?;
        Ok(asked)
    }

    fn set_pointers(&self, program: &LoadedModule, table: &UploadedTable) -> Result<(), CudaError> {
        for (name, memory) in [("table", &table.words), ("asked", &table.asked)] {
            self.set_global(program, name, &memory.device_ptr(&self.compute).0.to_ne_bytes())?;
        }
        Ok(())
    }

    fn upload_division(
        &self,
        program: &LoadedModule,
        division: &Division,
        kernels: Arc<DivisionKernels>,
    ) -> Result<UploadedDivision, cudarc::driver::DriverError> {
        let Division { center, unit, levels, coarse_levels, leaf_lists, short_list, shorter, max_stalls, .. } =
            *division;
        let Division { factors, first_boxes, boxes, joins, .. } = division;
        // Memory of no bytes has no address.
        let or_one = |numbers: &[f32]| self.compute.clone_htod(if numbers.is_empty() { &[0.0][..] } else { numbers });
        let first_boxes: &[u32] = if first_boxes.is_empty() { &[0] } else { first_boxes };
        Ok(UploadedDivision {
            rules: Rules {
                center: [center.x, center.y, center.z],
                unit,
                shorter,
                levels,
                coarse_levels,
                leaf_lists,
                short_list,
                max_stalls,
            },
            factors: or_one(factors)?,
            boxes: or_one(boxes)?,
            joins: or_one(joins)?,
            first_boxes: self.compute.clone_htod(first_boxes)?,
            state: self.compute.alloc_zeros(2)?,
            scratch: self.compute.alloc_zeros(1)?,
            measure: program.module.load_function("measure")?,
            kernels,
        })
    }

    /// Number of cells that launches that have ended asked for.
    pub(in crate::cuda) fn asked(&self, table: &UploadedTable) -> Result<usize, CudaError> {
        let mut count = [0];
        self.read_asked(table, 0, &mut count)?;
        Ok(count[0] as usize)
    }

    /// Reads words of `asked`.
    fn read_asked(&self, table: &UploadedTable, first: usize, words: &mut [u32]) -> Result<(), CudaError> {
        let mut read = || {
            self.copies.memcpy_dtoh(&table.asked.slice(first..first + words.len()), words)?;
            self.copies.synchronize()
        };
        read().map_err(CudaError::driver_error("read from the GPU which cells it needs"))
    }

    /// Sorts the cells that were asked for, those with the longest lists first; returns the numbers of operations of the
    /// lists.
    fn sort_asked(&self, table: &mut UploadedTable) -> Result<Vec<usize>, CudaError> {
        let count = self.asked(table)?.min(MAX_ASKED);
        if count == 0 {
            return Ok(Vec::new());
        }
        let (mut indices, mut lengths) = (vec![0; count], vec![0; count]);
        self.read_asked(table, ASKED_HEAD, &mut indices)?;
        self.read_asked(table, ASKED_HEAD + MAX_ASKED, &mut lengths)?;
        let mut cells: Vec<(u32, u32)> = lengths.into_iter().zip(indices).collect();
        cells.sort_unstable_by(|a, b| b.cmp(a));
        let indices: Vec<u32> = cells.iter().map(|cell| cell.1).collect();
        self.compute
            .memcpy_htod(&indices, &mut table.asked.slice_mut(ASKED_HEAD..ASKED_HEAD + count))
            .map_err(CudaError::driver_error("sort the cells that a GPU needs"))?;
        Ok(cells.iter().map(|cell| (cell.0 / OPERATION_WORDS) as usize).collect())
    }

    /// Divides the cells that all launches so far asked for, some at a time, while `go_on` allows it.
    pub(in crate::cuda) fn divide_asked(
        &self,
        program: &LoadedModule,
        table: &mut UploadedTable,
        go_on: &dyn Fn() -> Result<(), CudaError>,
    ) -> Result<Made, CudaError> {
        self.compute.synchronize().map_err(CudaError::driver_error("render on the GPU"))?;
        let operations = self.sort_asked(table)?;
        let (mut first, count) = (0, operations.len());
        while first < count {
            go_on()?;
            let longest = operations[first];
            let cells = (SCRATCH_NUMBERS / scratch_of(longest).max(1)).clamp(1, count - first);
            if self.divide_some(program, table, first, cells, longest)? {
                first += cells;
            } else if !self.grow(table)? {
                return Ok(Made::NotAll);
            }
        }
        if count > 0 {
            let mut renew = || {
                let room = table.words.len();
                if table.asked.len() < BITS + room.div_ceil(32) {
                    table.asked = self.new_asked(room)?;
                    return Ok(());
                }
                self.compute.memset_zeros(&mut table.asked.slice_mut(..1))?;
                self.compute.memset_zeros(&mut table.asked.slice_mut(BITS..))
            };
            renew().map_err(copy_error(table.words.len() / 8))?;
            self.set_pointers(program, table)?;
        }
        Ok(if count > 0 { Made::All } else { Made::Nothing })
    }

    /// Divides some of the cells that were asked for; returns whether there was room.
    fn divide_some(
        &self,
        program: &LoadedModule,
        table: &mut UploadedTable,
        first: usize,
        cells: usize,
        longest: usize,
    ) -> Result<bool, CudaError> {
        let start = table.used + cells * BLOCK_WORDS;
        if start > table.words.len() {
            return Ok(false);
        }
        // The leaves are measured by the scene's function, which reads the table.
        self.set_pointers(program, table)?;
        let numbers = cells * scratch_of(longest);
        let Some(division) = &mut table.division else { return Ok(true) };
        let mut divide = || {
            let UploadedDivision { rules, factors, boxes, joins, first_boxes, state, scratch, .. } = division;
            if scratch.len() < numbers {
                // SAFETY: each thread reads only what it has written.
                *scratch = unsafe { self.compute.alloc(numbers) }?;
            }
            self.compute.memcpy_htod(&[start as u32, 0], state)?;
            let number = |memory: &CudaSlice<f32>| memory.device_ptr(&self.compute).0;
            let word = |memory: &CudaSlice<u32>| memory.device_ptr(&self.compute).0;
            let arguments = DivisionArguments {
                words: word(&table.words),
                state: word(state),
                missing: word(&table.asked) + ((ASKED_HEAD + first) * size_of::<u32>()) as u64,
                factors: number(factors),
                boxes: number(boxes),
                joins: number(joins),
                first_boxes: word(first_boxes),
                scratch: number(scratch),
                cells: cells as u32,
                first_block: table.used as u32,
                longest: longest as u32,
                capacity: table.words.len() as u32,
                rules: *rules,
            };
            let UploadedDivision { measure, kernels, .. } = division;
            let DivisionKernels { divide, publish } = &**kernels;
            let of_blocks = cells * BLOCK_CELLS as usize;
            for (function, threads) in [(&*measure, longest * of_blocks), (divide, of_blocks), (publish, cells)] {
                let config = LaunchConfig {
                    grid_dim: (threads.div_ceil(THREADS as usize) as u32, 1, 1),
                    block_dim: (THREADS, 1, 1),
                    shared_mem_bytes: 0,
                };
                let mut launch = self.compute.launch_builder(function);
                launch.arg(&arguments);
                // SAFETY: the argument matches that of the kernels in measure.cu and divide.cu. They write only inside of the words
                // beyond `used`, of the scratch memory, and the words of the divided cells.
                unsafe { launch.launch(config) }?;
            }
            let mut after = [0, 0];
            self.compute.memcpy_dtoh(&division.state, &mut after[..])?;
            self.compute.synchronize()?;
            Ok(after)
        };
        let [used, is_full] = divide().map_err(copy_error(numbers * size_of::<f32>()))?;
        if is_full == 0 {
            table.used = used as usize;
        }
        Ok(is_full == 0)
    }

    /// Doubles the room of a table; returns whether there is memory for that.
    fn grow(&self, table: &mut UploadedTable) -> Result<bool, CudaError> {
        let room = (2 * table.words.len()).min(table.limit);
        if room <= table.words.len() {
            return Ok(false);
        }
        let mut copy = || {
            // SAFETY: as in `set_table`.
            let mut words = unsafe { self.compute.alloc::<u32>(room) }?;
            self.compute.memcpy_dtod(&table.words.slice(..table.used), &mut words.slice_mut(..table.used))?;
            table.words = words;
            Ok(true)
        };
        match copy().map_err(copy_error(room * size_of::<u32>())) {
            Err(CudaError::OutOfMemory { .. }) => Ok(false),
            copied => copied,
        }
    }
}
