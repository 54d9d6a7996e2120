//! Flags that several commands share.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use proto::Client;
use worker::{CpuRenderer, Simd};

use crate::failure::Misuse;

/// What `--server` is unless said.
pub(crate) const DEFAULT_SERVER: &str = "http://127.0.0.1:8080";
/// Most threads one renderer starts.
pub(crate) const MAX_THREADS: u32 = 4096;

const NO_GPU: &str = "this build renders on CPUs only: leave --device out, or say --device cpu";

/// The server that a client command talks to.
#[derive(Debug, Args)]
pub(crate) struct ServerArguments {
    /// Address of the server.
    #[arg(long, value_name = "URL", env = "SDFARM_SERVER", default_value = DEFAULT_SERVER)]
    server: String,
}

impl ServerArguments {
    /// A client of that server.
    pub(crate) fn client(&self) -> anyhow::Result<Client> {
        Ok(Client::new(&self.server)?)
    }
}

/// What to render on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Device {
    /// The best there is.
    Auto,
    /// The processor.
    Cpu,
    /// An NVIDIA GPU.
    Cuda,
}

impl Device {
    /// Refuses a device that this build can't render on.
    pub(crate) fn check(self) -> anyhow::Result<()> {
        match self {
            Self::Auto | Self::Cpu => Ok(()),
            Self::Cuda => Err(Misuse(NO_GPU.to_owned()).into()),
        }
    }
}

/// What a command that renders renders on.
#[derive(Clone, Copy, Debug, Args)]
pub(crate) struct RendererArguments {
    /// What to render on.
    #[arg(long, env = "SDFARM_DEVICE", default_value = "auto")]
    pub(crate) device: Device,
    /// Threads of a CPU renderer [default: one for each core].
    #[arg(long, value_name = "N", env = "SDFARM_THREADS", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_THREADS)))]
    pub(crate) threads: Option<u32>,
    /// Vector instructions of a CPU renderer; the picture is the same with each.
    #[arg(long, env = "SDFARM_SIMD", default_value = "auto", value_parser = simd_parser())]
    pub(crate) simd: Simd,
}

impl RendererArguments {
    /// Starts the renderer.
    pub(crate) fn renderer(&self) -> anyhow::Result<CpuRenderer> {
        self.device.check()?;
        Ok(CpuRenderer::new(self.threads.map(|threads| threads as usize), self.simd)?)
    }
}

/// Reads `--simd`.
pub(crate) fn simd_parser() -> impl TypedValueParser<Value = Simd> {
    PossibleValuesParser::new(["auto", "avx512", "avx2", "sse4.2", "scalar"])
        .map(|name| name.parse().expect("the list above holds the levels' names"))
}
