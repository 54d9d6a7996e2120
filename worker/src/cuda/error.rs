//! Errors of CUDA devices, with their fixes.

use cudarc::driver::DriverError;
use cudarc::driver::sys::CUresult;

use tape::InvalidTape;

use super::compiler::MAX_SOURCE_BYTES;

/// Error of a GPU operation.
#[derive(Debug, thiserror::Error)]
pub enum CudaError {
    /// No driver is installed.
    #[error("no NVIDIA driver is installed here (libcuda is missing): install one, or render with --device cpu")]
    NoDriver,
    /// The driver lacks a function.
    #[error(
        "the NVIDIA driver is too old: it supports CUDA {version} and lacks {missing}; install driver 570 or newer"
    )]
    OldDriver {
        /// CUDA version that the driver supports: 12.4.
        version: String,
        /// Missing function.
        missing: &'static str,
    },
    /// A driver is installed, but finds no GPU.
    #[error("the NVIDIA driver finds no GPU here: check the output of nvidia-smi, or render with --device cpu")]
    NoDevice,
    /// There are GPUs, but not the requested one.
    #[error("there is no GPU {ordinal} here: there are {count}, counted from 0")]
    NoSuchDevice {
        /// Requested ordinal.
        ordinal: usize,
        /// Number of GPUs.
        count: usize,
    },
    /// No run-time compiler is installed.
    #[error(
        "CUDA's run-time compiler is missing (libnvrtc): install the package cuda-nvrtc, or put its folder on LD_LIBRARY_PATH"
    )]
    NoCompiler,
    /// The compiler lacks a function.
    #[error("CUDA's run-time compiler is too old: it lacks {missing}; install cuda-nvrtc 12 or newer")]
    OldCompiler {
        /// Missing function.
        missing: &'static str,
    },
    /// The compiler does not support this GPU.
    #[error(
        "CUDA's run-time compiler {version} cannot compile for this GPU (sm_{architecture}): install a newer cuda-nvrtc"
    )]
    UnknownArchitecture {
        /// The compiler's version: 12.4.
        version: String,
        /// Major and minor compute capability: 90.
        architecture: u32,
    },
    /// The compiler rejected the source.
    #[error("the scene's kernel could not be compiled: {log}")]
    Compile {
        /// The compiler's log.
        log: String,
    },
    /// The scene's formulas are too long.
    #[error(
        "the scene's kernel has {mib} MiB of source, and at most {} are compiled: render it with --device cpu, or use fewer nodes and textures",
        MAX_SOURCE_BYTES >> 20
    )]
    LongSource {
        /// Size of the source.
        mib: usize,
    },
    /// The scene is too large for straight-line code.
    #[error("the scene has {nodes} nodes, and a GPU takes at most {most}: render it with --device cpu")]
    TooLarge {
        /// Number of nodes.
        nodes: u32,
        /// Maximum on the GPU.
        most: u32,
    },
    /// The GPU is out of memory.
    #[error(
        "the GPU is out of memory for {bytes} bytes: close other programs that use it, or render smaller tiles (--tile)"
    )]
    OutOfMemory {
        /// Requested size.
        bytes: usize,
    },
    /// The self-test's result differs from the expected bits.
    #[error(
        "the GPU's results are wrong: {differing} of {values} values of the self-test differ; do not use it for a farm"
    )]
    SelfTestFailed {
        /// Number of differing values.
        differing: usize,
        /// Number of values.
        values: usize,
    },
    /// Any other error of the driver.
    #[error("could not {action}: {name} ({text})")]
    Driver {
        /// Attempted action.
        action: &'static str,
        /// The driver's name for the error.
        name: String,
        /// The driver's message.
        text: String,
        /// Whether this process can no longer use the GPU.
        is_lost: bool,
    },
    /// The job is invalid at this frame.
    #[error("the job is invalid in this frame")]
    InvalidFrame(#[from] scene::FrameError),
    /// The cells of the scene had no room.
    #[error("{0}")]
    Cells(Box<crate::RenderError>),
    /// The formulas were recorded wrongly.
    #[error("the recorded formulas are invalid, which is a fault of sdfarm")]
    InvalidTape(#[from] InvalidTape),
    /// The render was cancelled.
    #[error("the render was cancelled")]
    Cancelled,
}

impl From<crate::RenderError> for CudaError {
    fn from(error: crate::RenderError) -> Self {
        Self::Cells(Box::new(error))
    }
}

impl CudaError {
    /// Wraps an error of the driver with the attempted `action`.
    pub(super) fn driver_error(action: &'static str) -> impl Fn(DriverError) -> Self {
        move |error| {
            let words = |text: Result<&std::ffi::CStr, DriverError>| {
                text.map_or_else(|_| format!("error {}", error.0 as u32), |text| text.to_string_lossy().into_owned())
            };
            let (name, text) = (words(error.error_name()), words(error.error_string()));
            Self::Driver { action, name, text, is_lost: is_lost(error.0) }
        }
    }

    /// Whether this process can no longer use the GPU.
    pub fn is_lost(&self) -> bool {
        matches!(self, Self::Driver { is_lost: true, .. } | Self::SelfTestFailed { .. })
    }
}

/// Errors after which every later call fails too: only a new process may be able to use the GPU.
fn is_lost(code: CUresult) -> bool {
    !matches!(
        code,
        CUresult::CUDA_ERROR_OUT_OF_MEMORY
            | CUresult::CUDA_ERROR_INVALID_VALUE
            | CUresult::CUDA_ERROR_INVALID_IMAGE
            | CUresult::CUDA_ERROR_NO_BINARY_FOR_GPU
            | CUresult::CUDA_ERROR_NOT_FOUND
            | CUresult::CUDA_ERROR_LAUNCH_OUT_OF_RESOURCES
    )
}
