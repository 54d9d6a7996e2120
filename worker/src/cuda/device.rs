//! One GPU: memory, kernels and launches, as safe functions.
//!
//! cudarc panics if a library or one of its functions is missing, so both are checked first.

#![expect(unsafe_code, reason = "a GPU's driver is a C library, and its programs see raw memory")]

mod table;

use std::sync::{Arc, OnceLock};

use cudarc::driver::sys::{self, CUdevice_attribute, CUevent_flags};
use cudarc::driver::{
    CudaContext, CudaEvent, CudaFunction, CudaModule, CudaSlice, CudaStream, DevicePtr, DeviceRepr, LaunchConfig,
    PinnedHostSlice, PushKernelArg, result,
};
use cudarc::nvrtc::Ptx;
pub(super) use table::{DivisionKernels, UploadedTable};

use super::error::CudaError;
use super::launches::LaunchLayout;

/// Every driver function that is called through cudarc.
const FUNCTIONS: [&str; 40] = [
    "cuInit",
    "cuDriverGetVersion",
    "cuGetErrorName",
    "cuGetErrorString",
    "cuDeviceGetCount",
    "cuDeviceGet",
    "cuDeviceGetName",
    "cuDeviceGetAttribute",
    "cuDevicePrimaryCtxRetain",
    "cuDevicePrimaryCtxRelease_v2",
    "cuCtxGetCurrent",
    "cuCtxSetCurrent",
    "cuCtxSynchronize",
    "cuStreamCreate",
    "cuStreamDestroy_v2",
    "cuStreamSynchronize",
    "cuStreamWaitEvent",
    "cuEventCreate",
    "cuEventDestroy_v2",
    "cuEventRecord",
    "cuEventSynchronize",
    "cuEventElapsedTime_v2",
    "cuMemAllocAsync",
    "cuMemAlloc_v2",
    "cuMemFreeAsync",
    "cuMemFree_v2",
    "cuMemHostAlloc",
    "cuMemFreeHost",
    "cuMemcpyHtoDAsync_v2",
    "cuMemsetD8Async",
    "cuMemcpyDtoHAsync_v2",
    "cuMemcpyDtoDAsync_v2",
    "cuModuleLoadData",
    "cuModuleUnload",
    "cuModuleGetFunction",
    "cuModuleGetGlobal_v2",
    "cuFuncGetAttribute",
    "cuLaunchKernel",
    "cuOccupancyMaxActiveBlocksPerMultiprocessorWithFlags",
    "cuMemGetInfo_v2",
];

/// Block dimensions that are tried for each kernel: of few threads, because a block may need no more registers than a
/// multiprocessor has.
pub const BLOCK_DIMS: [BlockDim; 5] = [
    BlockDim { columns: 8, rows: 8 },
    BlockDim { columns: 4, rows: 8 },
    BlockDim { columns: 8, rows: 4 },
    BlockDim { columns: 4, rows: 16 },
    BlockDim { columns: 16, rows: 4 },
];

/// Pixels of a block: columns and rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockDim {
    /// Pixels in the horizontal direction.
    pub columns: u32,
    /// Pixels in the vertical direction.
    pub rows: u32,
}

/// Error returned when a text is not block dimensions.
#[derive(Debug, thiserror::Error)]
#[error("write block dimensions as columns x rows of pixels, such as 16x8, at most 1024 pixels")]
pub struct ParseBlockDimError;

impl std::str::FromStr for BlockDim {
    type Err = ParseBlockDimError;

    fn from_str(text: &str) -> Result<Self, ParseBlockDimError> {
        let (columns, rows) = text.split_once('x').ok_or(ParseBlockDimError)?;
        let number = |text: &str| text.parse().ok().filter(|number| (1..=1024).contains(number));
        let shape =
            Self { columns: number(columns).ok_or(ParseBlockDimError)?, rows: number(rows).ok_or(ParseBlockDimError)? };
        if shape.pixels() <= 1024 { Ok(shape) } else { Err(ParseBlockDimError) }
    }
}

impl std::fmt::Display for BlockDim {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.columns, self.rows)
    }
}

impl BlockDim {
    /// Pixels of the block.
    pub fn pixels(self) -> u32 {
        self.columns * self.rows
    }
}

/// Rectangle of pixels, as declared in `kernel.cu`.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct DeviceTile {
    pub(super) x: u32,
    pub(super) y: u32,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) first_block: u32,
    pub(super) columns: u32,
    pub(super) start: u64,
    pub(super) pitch: u64,
    pub(super) plane: u64,
}

// SAFETY: it is plain integers, in C's order and with C's padding.
unsafe impl DeviceRepr for DeviceTile {}

/// Blocks of a launch; matches `kernel.cu`.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Blocks {
    groups: u64,
    first: u32,
    columns: u32,
    rows: u32,
}

// SAFETY: as above.
unsafe impl DeviceRepr for Blocks {}

/// Layout whose tiles have been copied to the GPU.
#[derive(Debug)]
pub(super) struct UploadedLayout {
    tiles: CudaSlice<DeviceTile>,
    groups: CudaSlice<u32>,
}

/// One GPU.
#[derive(Debug)]
pub(super) struct Device {
    context: Arc<CudaContext>,
    compute: Arc<CudaStream>,
    copies: Arc<CudaStream>,
    /// Product name.
    pub(super) name: String,
    /// Major and minor compute capability: 90.
    pub(super) architecture: u32,
    pub(super) multiprocessors: u32,
    pub(super) clock_khz: u32,
}

/// Kernel of a scene, loaded on a GPU.
#[derive(Debug)]
pub(super) struct LoadedModule {
    module: Arc<CudaModule>,
    render: CudaFunction,
    /// Threads of `render` for each pixel.
    together: u32,
    layers: Option<CudaFunction>,
    /// Kernels that divide the scene's cells, if it has any.
    division: Option<Arc<DivisionKernels>>,
}

/// Resources of a compiled kernel.
#[derive(Clone, Copy, Debug)]
pub struct Resources {
    /// Registers a thread.
    pub registers: u32,
    /// Bytes per thread of spilled registers in local memory.
    pub local_bytes: u32,
    /// Occupancy for blocks of a given shape: resident fraction of a multiprocessor's threads.
    pub occupancy: f64,
}

/// Pixels on the GPU, and the host memory they are copied to.
#[derive(Debug)]
pub(super) struct Buffer {
    device: CudaSlice<f32>,
    host: PinnedHostSlice<f32>,
    /// Recorded after the last copy to the host.
    copied: CudaEvent,
}

/// Copy of the pixels of a buffer, on the GPU.
pub(super) type SavedPixels = CudaSlice<f32>;

/// Blocks and samples of a launch.
#[derive(Clone, Copy, Debug)]
pub(super) struct LaunchRange {
    pub(super) first_block: u32,
    pub(super) blocks: u32,
    pub(super) first_sample: u32,
    pub(super) end_sample: u32,
    /// Whether the sums of the pixels become their means.
    pub(super) is_last: bool,
    /// Whether the layers of the pixels are rendered.
    pub(super) has_layers: bool,
}

/// Launch in progress.
#[derive(Debug)]
pub(super) struct PendingLaunch {
    start: CudaEvent,
    end: CudaEvent,
}

impl PendingLaunch {
    /// Waits for completion; returns the duration in milliseconds.
    pub(super) fn wait(&self) -> Result<f64, CudaError> {
        self.start.elapsed_ms(&self.end).map(f64::from).map_err(CudaError::driver_error("render on the GPU"))
    }
}

/// Number of GPUs; an error if no usable driver is installed.
pub(super) fn count() -> Result<usize, CudaError> {
    static MISSING_FUNCTION: OnceLock<Option<&str>> = OnceLock::new();
    // SAFETY: loading the driver's library runs its initializers, which only set up its own state.
    if !unsafe { sys::is_culib_present() } {
        return Err(CudaError::NoDriver);
    }
    let lacks = MISSING_FUNCTION.get_or_init(|| {
        // SAFETY: the library is present, so this does not panic; the symbols are only looked up,
        // never called.
        FUNCTIONS.into_iter().find(|name| unsafe { sys::culib().get::<*const ()>(name.as_bytes()) }.is_err())
    });
    if let Some(missing) = lacks {
        return Err(CudaError::OldDriver { version: version(), missing });
    }
    match result::init().and_then(|()| result::device::get_count()) {
        Ok(count) => Ok(usize::try_from(count).unwrap_or(0)),
        Err(error) if error.0 == sys::CUresult::CUDA_ERROR_NO_DEVICE => Ok(0),
        Err(error) => Err(CudaError::driver_error("start the NVIDIA driver")(error)),
    }
}

/// CUDA version of the driver, which any driver reports.
fn version() -> String {
    let mut version = 0;
    // SAFETY: the library is loaded, and every release of it has this function, which writes one integer.
    let known = unsafe { sys::culib().get::<*const ()>(b"cuDriverGetVersion") }.is_ok()
        && unsafe { sys::cuDriverGetVersion(&raw mut version) } == sys::CUresult::CUDA_SUCCESS;
    if known { format!("{}.{}", version / 1000, version % 1000 / 10) } else { "of an unknown version".to_owned() }
}

impl Device {
    /// Opens the GPU with this ordinal.
    pub(super) fn open(ordinal: usize) -> Result<Self, CudaError> {
        let count = count()?;
        if count == 0 {
            return Err(CudaError::NoDevice);
        }
        if ordinal >= count {
            return Err(CudaError::NoSuchDevice { ordinal, count });
        }
        let open = || {
            let context = CudaContext::new(ordinal)?;
            let (major, minor) = context.compute_capability()?;
            let number = |attribute| context.attribute(attribute).map(|number| u32::try_from(number).unwrap_or(0));
            Ok(Self {
                compute: context.new_stream()?,
                copies: context.new_stream()?,
                name: context.name()?,
                architecture: u32::try_from(major * 10 + minor).unwrap_or(0),
                multiprocessors: number(CUdevice_attribute::CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT)?,
                clock_khz: number(CUdevice_attribute::CU_DEVICE_ATTRIBUTE_CLOCK_RATE)?,
                context,
            })
        };
        open().map_err(CudaError::driver_error("open the GPU"))
    }

    /// Its ordinal.
    pub(super) fn ordinal(&self) -> usize {
        self.context.ordinal()
    }

    /// Loads machine code, of a kernel with `together` threads for each pixel, with or without layers.
    pub(super) fn load(
        &self,
        code: &[u8],
        together: u32,
        has_layers: bool,
        division: Option<&Arc<DivisionKernels>>,
    ) -> Result<LoadedModule, CudaError> {
        let load = || {
            let module = self.context.load_module(Ptx::from_binary(code.to_vec()))?;
            let render = module.load_function("render")?;
            Ok(LoadedModule {
                render,
                together,
                layers: has_layers.then(|| module.load_function("layers")).transpose()?,
                division: division.cloned(),
                module,
            })
        };
        load().map_err(CudaError::driver_error("load the scene's kernel"))
    }

    /// Allocates this many numbers on host and device.
    pub(super) fn buffer(&self, numbers: usize) -> Result<Buffer, CudaError> {
        // SAFETY: neither memory has a value yet. A kernel writes the device's before it is copied, and only
        // the copied part of the host's is read.
        let allocate = || unsafe {
            let host = self.context.alloc_pinned_with_flags(numbers, 0)?;
            let copied = self.context.new_event(Some(CUevent_flags::CU_EVENT_BLOCKING_SYNC))?;
            Ok(Buffer { device: self.compute.alloc(numbers)?, host, copied })
        };
        allocate().map_err(|error: cudarc::driver::DriverError| match error.0 {
            sys::CUresult::CUDA_ERROR_OUT_OF_MEMORY => CudaError::OutOfMemory { bytes: numbers * size_of::<f32>() },
            _ => CudaError::driver_error("allocate memory on the GPU")(error),
        })
    }

    /// Sets a kernel's constants: later launches see them, earlier ones do not.
    pub(super) fn set_uniforms(&self, program: &LoadedModule, bits: &[u32]) -> Result<(), CudaError> {
        let bytes: Vec<u8> = bits.iter().flat_map(|bits| bits.to_ne_bytes()).collect();
        self.set_global(program, "uniforms", &bytes)
    }

    fn set_global(&self, program: &LoadedModule, name: &str, bytes: &[u8]) -> Result<(), CudaError> {
        let set = || {
            let mut place = program.module.get_global(name, &self.compute)?;
            self.compute.memcpy_htod(bytes, &mut place)
        };
        if bytes.is_empty() {
            Ok(())
        } else {
            set().map_err(CudaError::driver_error("copy the scene's numbers to the GPU"))
        }
    }

    /// Copies the tiles of a layout to the GPU.
    pub(super) fn lay_out(&self, layout: &LaunchLayout) -> Result<UploadedLayout, CudaError> {
        let copy = || {
            let (tiles, groups) = (self.compute.clone_htod(&layout.tiles)?, self.compute.clone_htod(&layout.groups)?);
            Ok(UploadedLayout { tiles, groups })
        };
        copy().map_err(CudaError::driver_error("copy tiles to the GPU"))
    }

    /// Starts one launch of a render; all pixels of the layout must fit into the buffer.
    pub(super) fn launch(
        &self,
        program: &LoadedModule,
        block: BlockDim,
        layout: &UploadedLayout,
        part: LaunchRange,
        out: &mut Buffer,
    ) -> Result<PendingLaunch, CudaError> {
        let config =
            |threads| LaunchConfig { grid_dim: (part.blocks, 1, 1), block_dim: (threads, 1, 1), shared_mem_bytes: 0 };
        let (tiles, count) = (&layout.tiles, layout.tiles.len() as u32);
        let blocks = Blocks {
            groups: layout.groups.device_ptr(&self.compute).0,
            first: part.first_block,
            columns: block.columns,
            rows: block.rows,
        };
        let (first, end, is_last) = (part.first_sample as f32, part.end_sample as f32, u32::from(part.is_last));
        // A thread that waits sleeps, because the cores are needed for encoding.
        let event = || self.compute.record_event(Some(CUevent_flags::CU_EVENT_BLOCKING_SYNC));
        let mut launch = || {
            let start = event()?;
            let mut render = self.compute.launch_builder(&program.render);
            render.arg(tiles).arg(&count).arg(&blocks);
            render.arg(&first).arg(&end).arg(&is_last).arg(&mut out.device);
            // SAFETY: the arguments match the parameters of `render` in samples.cu and paths.cu in number, order and type. It writes
            // only pixels of the tiles, which the caller placed inside the buffer.
            unsafe { render.launch(config(program.threads(block))) }?;
            if let Some(layers) = program.layers.as_ref().filter(|_| part.has_layers) {
                let mut render = self.compute.launch_builder(layers);
                render.arg(tiles).arg(&count).arg(&blocks).arg(&mut out.device);
                // SAFETY: as above, for `layers`.
                unsafe { render.launch(config(block.pixels())) }?;
            }
            Ok(PendingLaunch { start, end: event()? })
        };
        launch().map_err(CudaError::driver_error("start a render on the GPU"))
    }

    /// Copies the pixels of a buffer on the GPU, after all launches so far.
    pub(super) fn copied(&self, buffer: &Buffer) -> Result<SavedPixels, CudaError> {
        self.compute.clone_dtod(&buffer.device).map_err(CudaError::driver_error("copy pixels on the GPU"))
    }

    /// Replaces the pixels of a buffer by a copy of them, after all launches so far.
    pub(super) fn restore(&self, buffer: &mut Buffer, copy: &SavedPixels) -> Result<(), CudaError> {
        self.compute.memcpy_dtod(copy, &mut buffer.device).map_err(CudaError::driver_error("copy pixels on the GPU"))
    }

    /// Starts copying the first numbers of a buffer back, after all launches so far have finished.
    pub(super) fn start_copy(&self, buffer: &mut Buffer, numbers: usize) -> Result<(), CudaError> {
        let mut fetch = || {
            let source = buffer.device.slice(..numbers);
            self.copies.memcpy_dtoh(&source, &mut buffer.host.as_mut_slice()?[..numbers])?;
            buffer.copied.record(&self.copies)
        };
        fetch().map_err(CudaError::driver_error("copy pixels from the GPU"))
    }

    /// Waits for the copy of a buffer, and for no later one; returns its numbers.
    pub(super) fn wait_copy(buffer: &Buffer) -> Result<&[f32], CudaError> {
        let wait = || {
            buffer.copied.synchronize()?;
            buffer.host.as_slice()
        };
        wait().map_err(CudaError::driver_error("copy pixels from the GPU"))
    }

    /// Resources of a kernel, and its occupancy for a block shape.
    pub(super) fn resources(&self, program: &LoadedModule, block: BlockDim) -> Result<Resources, CudaError> {
        let look = || {
            let threads = program.threads(block);
            let blocks = program.render.occupancy_max_active_blocks_per_multiprocessor(threads, 0, None)?;
            let most =
                self.context.attribute(CUdevice_attribute::CU_DEVICE_ATTRIBUTE_MAX_THREADS_PER_MULTIPROCESSOR)?;
            Ok(Resources {
                registers: u32::try_from(program.render.num_regs()?).unwrap_or(0),
                local_bytes: u32::try_from(program.render.local_size_bytes()?).unwrap_or(0),
                occupancy: f64::from(blocks * threads) / f64::from(most.max(1)),
            })
        };
        look().map_err(CudaError::driver_error("query the scene's kernel on the GPU"))
    }
}

impl LoadedModule {
    /// Threads of a block of the kernel that renders.
    pub(super) fn threads(&self, block: BlockDim) -> u32 {
        block.pixels() * self.together
    }
}

impl Buffer {
    pub(super) fn floats(&self) -> usize {
        self.host.len()
    }
}
