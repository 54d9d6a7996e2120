//! CUDA's run-time compiler: compiles source to machine code for one architecture. Needs no GPU.
//!
//! cudarc panics if a library or one of its functions is missing, so both are checked first.

#![expect(unsafe_code, reason = "the compiler is a C library, found at run time")]

use std::ffi::{CString, c_char};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

use cudarc::nvrtc::result::NvrtcError;
use cudarc::nvrtc::{result, sys};

use super::error::CudaError;
use crate::CancelFlag;

/// How often a waiting render checks whether it has been cancelled.
const CANCEL_INTERVAL: Duration = Duration::from_millis(10);
/// Every function that is called here.
const FUNCTIONS: [&str; 11] = [
    "nvrtcVersion",
    "nvrtcGetNumSupportedArchs",
    "nvrtcGetSupportedArchs",
    "nvrtcCreateProgram",
    "nvrtcCompileProgram",
    "nvrtcGetProgramLogSize",
    "nvrtcGetProgramLog",
    "nvrtcGetCUBINSize",
    "nvrtcGetCUBIN",
    "nvrtcDestroyProgram",
    "nvrtcGetErrorString",
];

/// Maximum size of a source. The nodes of a kernel are limited, and so their source is far below.
pub(super) const MAX_SOURCE_BYTES: usize = 8 << 20;

/// No contraction, flushing or approximation except where the source asks for it.
const OPTIONS: [&str; 3] = ["--fmad=false", "--std=c++17", "--diag-suppress=177"];

/// NVRTC, as found on this machine.
#[derive(Clone, Debug)]
pub struct Compiler {
    /// Its version: 13.0.
    pub version: String,
    architectures: Vec<u32>,
}

impl Compiler {
    /// Finds the compiler.
    pub fn find() -> Result<Self, CudaError> {
        static MISSING_FUNCTION: OnceLock<Option<&str>> = OnceLock::new();
        // SAFETY: loading a library runs its initializers; NVRTC's only set up its own state.
        if !unsafe { sys::is_culib_present() } {
            return Err(CudaError::NoCompiler);
        }
        let lacks = MISSING_FUNCTION.get_or_init(|| {
            // SAFETY: the library is present, so this does not panic; the symbols are only looked
            // up, never called.
            FUNCTIONS.into_iter().find(|name| unsafe { sys::culib().get::<*const ()>(name.as_bytes()) }.is_err())
        });
        if let Some(missing) = lacks {
            return Err(CudaError::OldCompiler { missing });
        }
        let (mut major, mut minor, mut count) = (0, 0, 0);
        // SAFETY: both functions write the integers they are given, and their presence was checked.
        unsafe {
            check(sys::nvrtcVersion(&raw mut major, &raw mut minor))?;
            check(sys::nvrtcGetNumSupportedArchs(&raw mut count))?;
        }
        let mut architectures = vec![0; usize::try_from(count).unwrap_or(0)];
        // SAFETY: the list has room for the number of entries that the compiler reported.
        unsafe { check(sys::nvrtcGetSupportedArchs(architectures.as_mut_ptr())) }?;
        let architectures = architectures.into_iter().filter_map(|number| u32::try_from(number).ok()).collect();
        Ok(Self { version: format!("{major}.{minor}"), architectures })
    }

    /// Compiles a kernel for an architecture: 90 for compute capability 9.0.
    pub fn compile(&self, text: &str, architecture: u32) -> Result<Vec<u8>, CudaError> {
        if !self.architectures.contains(&architecture) {
            return Err(CudaError::UnknownArchitecture { version: self.version.clone(), architecture });
        }
        if text.len() > MAX_SOURCE_BYTES {
            return Err(CudaError::LongSource { mib: text.len() >> 20 });
        }
        let text = CString::new(text).expect("a kernel's source has no byte 0");
        let program = NvrtcProgram(result::create_program(&text, Some(c"scene.cu")).map_err(refused)?);
        let options = options(architecture);
        // SAFETY: the program was created above and is destroyed only when it is dropped.
        match unsafe { result::compile_program(program.0, &options) } {
            Ok(()) => program.machine_code(),
            Err(_) => Err(CudaError::Compile { log: program.log() }),
        }
    }
}

/// Compiles on a thread of its own, because the compiler cannot be interrupted: a cancelled render leaves it behind.
pub(super) fn compile_until_cancelled(
    compiler: &Compiler,
    text: &str,
    architecture: u32,
    cancel: &CancelFlag,
) -> Result<Vec<u8>, CudaError> {
    /// Locked by the thread that compiles, so that cancelled compilations do not add up.
    static COMPILING: Mutex<()> = Mutex::new(());
    let (sender, receiver) = mpsc::channel();
    let (compiler, text, flag) = (compiler.clone(), text.to_owned(), cancel.clone());
    std::thread::spawn(move || {
        let _compiling = COMPILING.lock().unwrap_or_else(PoisonError::into_inner);
        if !flag.is_cancelled() {
            // After a cancel, the result is dropped.
            let _ = sender.send(compiler.compile(&text, architecture));
        }
    });
    loop {
        match receiver.recv_timeout(CANCEL_INTERVAL) {
            Ok(compiled) => return compiled,
            Err(_) if cancel.is_cancelled() => return Err(CudaError::Cancelled),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                return Err(CudaError::Compile { log: "the compiler panicked".to_owned() });
            }
        }
    }
}

/// Options of the compiler: the machine code depends on nothing else but the source.
pub(super) fn options(architecture: u32) -> Vec<String> {
    std::iter::once(format!("--gpu-architecture=sm_{architecture}")).chain(OPTIONS.map(str::to_owned)).collect()
}

/// Program object of NVRTC.
struct NvrtcProgram(sys::nvrtcProgram);

impl Drop for NvrtcProgram {
    fn drop(&mut self) {
        // SAFETY: NVRTC created it, and nothing uses it any more. A failure cannot be handled.
        unsafe { result::destroy_program(self.0) }.unwrap_or_default();
    }
}

impl NvrtcProgram {
    fn log(&self) -> String {
        // SAFETY: the program is alive.
        let log = unsafe { result::get_program_log(self.0) }.unwrap_or_default();
        let bytes: Vec<u8> = log.into_iter().map(|letter| letter as u8).take_while(|&letter| letter != 0).collect();
        String::from_utf8_lossy(&bytes).trim().to_owned()
    }

    fn machine_code(&self) -> Result<Vec<u8>, CudaError> {
        let mut length = 0;
        // SAFETY: the program is alive and compiled, and the function writes one integer.
        unsafe { check(sys::nvrtcGetCUBINSize(self.0, &raw mut length)) }?;
        let mut code = vec![0_u8; length];
        // SAFETY: there is room for the number of bytes that the compiler reported.
        unsafe { check(sys::nvrtcGetCUBIN(self.0, code.as_mut_ptr().cast::<c_char>())) }?;
        Ok(code)
    }
}

fn check(code: sys::nvrtcResult) -> Result<(), CudaError> {
    code.result().map_err(refused)
}

fn refused(error: NvrtcError) -> CudaError {
    CudaError::Compile { log: format!("{:?}", error.0) }
}
