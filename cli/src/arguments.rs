//! Flags that several commands share.

use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use proto::{Client, ClientAuth, ClientError, Secret};
use worker::cuda::{BlockDim, CudaRenderer};
use worker::{CpuRenderer, RenderError, Renderer, Simd};

use crate::size::Size;
use crate::terminal::print_note;

/// Default of `--server`.
pub(crate) const DEFAULT_SERVER: &str = "http://127.0.0.1:8080";
/// Most threads one renderer starts.
pub(crate) const MAX_THREADS: u32 = 4096;

/// Server of a client command: its address and credentials.
#[derive(Debug, Args)]
pub(crate) struct ServerArguments {
    /// Address of the server.
    #[arg(long, value_name = "URL", env = "SDFARM_SERVER", default_value = DEFAULT_SERVER)]
    server: String,
    #[command(flatten)]
    auth: AuthArguments,
}

impl ServerArguments {
    /// Creates a client of the server.
    pub(crate) fn client(&self) -> anyhow::Result<Client> {
        Ok(Client::with_auth(&self.server, self.auth.auth()?)?)
    }
}

/// Credentials for calling the server.
#[derive(Clone, Debug, Args)]
pub(crate) struct AuthArguments {
    /// API key, as printed by `sdfarm key new`; prefer the variable, because process lists show arguments.
    #[arg(long, value_name = "KEY", env = "SDFARM_KEY", hide_env_values = true)]
    key: Option<Secret>,
    /// CA certificates (PEM) to trust for https servers [default: the system's].
    #[arg(long, value_name = "FILE", env = "SDFARM_CA")]
    ca: Option<PathBuf>,
}

impl AuthArguments {
    /// Converts the arguments to the client's form.
    pub(crate) fn auth(&self) -> Result<ClientAuth, ClientError> {
        Ok(ClientAuth::new(self.key.clone(), self.ca.as_deref())?)
    }

    /// Converts the arguments to the client's form, with another key.
    pub(crate) fn with_key(&self, key: Secret) -> Result<ClientAuth, ClientError> {
        Ok(ClientAuth::new(Some(key), self.ca.as_deref())?)
    }
}

/// Device to render on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DeviceChoice {
    /// The best available device: this GPU, or the first one; the CPU if no GPU can render.
    Auto(Option<usize>),
    /// The CPU.
    Cpu,
    /// An NVIDIA GPU: this one, or the first.
    Cuda(Option<usize>),
}

impl FromStr for DeviceChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (kind, ordinal) = match text.split_once(':') {
            Some((kind, number)) => (kind, Some(number.parse())),
            None => (text, None),
        };
        match (kind, ordinal.transpose()) {
            ("auto", Ok(ordinal)) => Ok(Self::Auto(ordinal)),
            ("cpu", Ok(None)) => Ok(Self::Cpu),
            ("cuda", Ok(ordinal)) => Ok(Self::Cuda(ordinal)),
            _ => Err("use auto, cpu, cuda (the first GPU) or cuda:N (GPU N, counted from 0)".to_owned()),
        }
    }
}

/// Device of a command that renders.
#[derive(Clone, Debug, Args)]
pub(crate) struct RendererArguments {
    /// Device to render on: auto, cpu, cuda or cuda:N.
    #[arg(long, env = "SDFARM_DEVICE", default_value = "auto")]
    pub(crate) device: DeviceChoice,
    /// Threads that render on a CPU and encode [default: one for each core].
    #[arg(long, value_name = "N", env = "SDFARM_THREADS", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_THREADS)))]
    pub(crate) threads: Option<u32>,
    /// Vector instructions of a CPU renderer; every choice gives the same picture.
    #[arg(long, env = "SDFARM_SIMD", default_value = "auto", value_parser = simd_parser())]
    pub(crate) simd: Simd,
    /// Maximum memory for the cells of a frame with many shapes, such as 500MB or 2GiB [default: up to 4GiB]; less is
    /// slower, and every choice gives the same picture.
    #[arg(long, value_name = "SIZE", env = "SDFARM_CELL_MEMORY")]
    pub(crate) cell_memory: Option<Size>,
    #[command(flatten)]
    pub(crate) cuda: CudaArguments,
}

/// Settings of a GPU renderer.
#[derive(Clone, Debug, Args)]
pub(crate) struct CudaArguments {
    /// Block dimensions on a GPU in pixels, such as 16x8, with a thread for each [default: the fastest layout for each
    /// scene]; every choice gives the same picture.
    #[arg(long, value_name = "COLUMNSxROWS", env = "SDFARM_BLOCK")]
    block: Option<BlockDim>,
    /// Folder for compiled GPU kernels [default: in the user's cache].
    #[arg(long, value_name = "FOLDER", env = "SDFARM_CACHE")]
    cache: Option<PathBuf>,
}

impl CudaArguments {
    /// Starts the GPU with this ordinal.
    pub(crate) fn renderer(&self, ordinal: usize) -> Result<CudaRenderer, RenderError> {
        let cache = self.cache.clone().or_else(worker::cuda::default_cache_folder);
        CudaRenderer::new(ordinal, cache.as_deref(), self.block)
    }
}

impl RendererArguments {
    /// Starts the renderer. Without a requested device it tries a GPU first.
    pub(crate) fn renderer(&self) -> Result<Arc<dyn Renderer>, RenderError> {
        let cell_bytes =
            self.cell_memory.map_or(usize::MAX, |Size(bytes)| usize::try_from(bytes).unwrap_or(usize::MAX));
        let ordinal = match self.device {
            DeviceChoice::Cpu => None,
            DeviceChoice::Cuda(ordinal) => Some(ordinal.unwrap_or(0)),
            DeviceChoice::Auto(ordinal) => worker::cuda::devices().is_ok().then_some(ordinal.unwrap_or(0)),
        };
        match ordinal.map(|ordinal| self.cuda.renderer(ordinal)) {
            Some(Ok(gpu)) => {
                let gpu = gpu.with_encoders(self.threads.map(|threads| threads as usize));
                return Ok(Arc::new(gpu.with_cell_memory(cell_bytes)));
            }
            Some(Err(error)) if matches!(self.device, DeviceChoice::Auto(_)) => {
                print_note(&format!("rendering on the CPU: {error}"));
            }
            Some(Err(error)) => return Err(error),
            None => {}
        }
        let cpu = CpuRenderer::new(self.threads.map(|threads| threads as usize), self.simd)?;
        Ok(Arc::new(cpu.with_cell_memory(cell_bytes)))
    }
}

/// Parser of `--simd`.
pub(crate) fn simd_parser() -> impl TypedValueParser<Value = Simd> {
    PossibleValuesParser::new(["auto", "avx512", "avx2", "portable", "sse4.2", "scalar"])
        .map(|name| name.parse().expect("the list above holds the levels' names"))
}
