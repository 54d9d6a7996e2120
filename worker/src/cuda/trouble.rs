//! What can go wrong with a GPU, and what to do about it.

use std::path::PathBuf;

use cudarc::driver::DriverError;
use cudarc::driver::sys::CUresult;

/// Why a GPU did not do something.
#[derive(Debug, thiserror::Error)]
pub enum Trouble {
    /// There is no driver.
    #[error("no NVIDIA driver is installed here (libcuda is missing): install one, or render with --device cpu")]
    NoDriver,
    /// The driver lacks something.
    #[error("the NVIDIA driver is too old: it speaks CUDA {version} and lacks {missing}; install driver 570 or newer")]
    OldDriver {
        /// The CUDA version it speaks: 12.4.
        version: String,
        /// The function that it does not have.
        missing: &'static str,
    },
    /// The driver is there, and no GPU.
    #[error("the NVIDIA driver finds no GPU here: see what nvidia-smi says, or render with --device cpu")]
    NoDevice,
    /// There are GPUs, and not this one.
    #[error("there is no GPU {ordinal} here: there are {count}, counted from 0")]
    NoSuchDevice {
        /// The one asked for.
        ordinal: usize,
        /// How many there are.
        count: usize,
    },
    /// There is no run-time compiler.
    #[error(
        "CUDA's run-time compiler is missing (libnvrtc): install the package cuda-nvrtc, or put its folder on LD_LIBRARY_PATH"
    )]
    NoCompiler,
    /// The compiler lacks something.
    #[error("CUDA's run-time compiler is too old: it lacks {missing}; install cuda-nvrtc 12 or newer")]
    OldCompiler {
        /// The function that it does not have.
        missing: &'static str,
    },
    /// The compiler does not know this GPU.
    #[error(
        "CUDA's run-time compiler {version} can't compile for this GPU (sm_{architecture}): install a newer cuda-nvrtc"
    )]
    UnknownArchitecture {
        /// The compiler's version: 12.4.
        version: String,
        /// Major and minor compute capability: 90.
        architecture: u32,
    },
    /// The compiler did not take the program.
    #[error("the scene's program could not be compiled{}: {log}", kept.as_ref().map(|path| format!(" (kept as {})", path.display())).unwrap_or_default())]
    Compile {
        /// What the compiler said.
        log: String,
        /// Where the program was kept.
        kept: Option<PathBuf>,
    },
    /// The scene is too large for straight-line code.
    #[error("the scene has {nodes} nodes, and a GPU takes at most {most}: render it with --device cpu")]
    TooLarge {
        /// Its nodes.
        nodes: u32,
        /// What a GPU takes.
        most: u32,
    },
    /// The GPU has not enough memory.
    #[error(
        "the GPU is out of memory for {bytes} bytes of pixels: close what else uses it, or render smaller tiles (--tile)"
    )]
    OutOfMemory {
        /// What was asked for.
        bytes: usize,
    },
    /// It renders, and not the right bits.
    #[error(
        "the GPU renders wrong bits: {differing} of {values} values of the self-test differ; let it render for no farm"
    )]
    WrongBits {
        /// Values that differ.
        differing: usize,
        /// All values.
        values: usize,
    },
    /// Any other answer of the driver.
    #[error("could not {action}: {name} ({text})")]
    Driver {
        /// What was tried.
        action: &'static str,
        /// The driver's name for the error.
        name: String,
        /// The driver's words.
        text: String,
        /// Whether the GPU will not work for this process again.
        is_lost: bool,
    },
    /// The job is not sound in this frame.
    #[error("the job can't be rendered in this frame")]
    Frame(#[from] scene::FrameError),
    /// The render was asked to stop.
    #[error("the render was cancelled")]
    Cancelled,
}

impl Trouble {
    /// What the driver said when `action` was tried.
    pub(super) fn of(action: &'static str) -> impl Fn(DriverError) -> Self {
        move |error| {
            let words = |text: Result<&std::ffi::CStr, DriverError>| {
                text.map_or_else(|_| format!("error {}", error.0 as u32), |text| text.to_string_lossy().into_owned())
            };
            let (name, text) = (words(error.error_name()), words(error.error_string()));
            Self::Driver { action, name, text, is_lost: is_lost(error.0) }
        }
    }

    /// Whether the GPU will not work for this process again.
    pub fn is_lost(&self) -> bool {
        matches!(self, Self::Driver { is_lost: true, .. } | Self::WrongBits { .. })
    }
}

/// Errors after which every later call fails too: only a new process can help, if anything can.
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
