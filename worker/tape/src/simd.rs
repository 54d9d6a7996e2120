//! Selection of the way in which a CPU evaluates pictures.

use std::fmt;
use std::str::FromStr;

use crate::x86::{AVX2, AVX512};

/// Error returned when this machine cannot evaluate with a level.
#[derive(Debug, thiserror::Error)]
#[error("this machine cannot evaluate with --simd {simd}: {reason}")]
pub struct Unavailable {
    /// The requested level.
    pub simd: Simd,
    /// The missing feature, and the fix.
    pub reason: String,
}

/// Way to evaluate pictures on a CPU. All are bit-identical.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Simd {
    /// The fastest of this CPU.
    #[default]
    Auto,
    /// Machine code for AVX-512: two vectors of 16 lanes.
    Avx512,
    /// Machine code for AVX2 and FMA: one vector of 8 lanes.
    Avx2,
    /// The interpreter, on any CPU: 256 lanes.
    Portable,
    /// The reference: one pixel at a time, in plain `f32`. A cancel takes effect after at most 64 samples of a pixel.
    Scalar,
}

impl Simd {
    /// Every level with a name, fastest first.
    pub const LEVELS: [Self; 4] = [Self::Avx512, Self::Avx2, Self::Portable, Self::Scalar];

    /// Name of the level, as flags spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Avx512 => "avx512",
            Self::Avx2 => "avx2",
            Self::Portable => "portable",
            Self::Scalar => "scalar",
        }
    }

    /// Whether this CPU has the instructions.
    pub fn is_available(self) -> bool {
        match self {
            Self::Auto | Self::Portable | Self::Scalar => true,
            Self::Avx512 => AVX512.is_available(),
            Self::Avx2 => AVX2.is_available(),
        }
    }

    /// The level itself; for `Auto`, the fastest level of this CPU.
    pub fn resolve_auto(self) -> Self {
        match self {
            Self::Auto => Self::LEVELS.into_iter().find(|level| level.is_available()).unwrap_or(Self::Scalar),
            Self::Avx512 | Self::Avx2 | Self::Portable | Self::Scalar => self,
        }
    }

    /// Fails if this CPU does not have the instructions.
    pub fn check(self) -> Result<(), Unavailable> {
        if self.is_available() {
            return Ok(());
        }
        Err(Unavailable { simd: self, reason: "its CPU does not have these instructions; use --simd auto".to_owned() })
    }
}

impl fmt::Display for Simd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Error returned when a name is not a SIMD level.
#[derive(Debug, thiserror::Error)]
#[error("\"{0}\" is not a SIMD level: use auto, avx512, avx2, portable or scalar")]
pub struct UnknownSimd(String);

impl FromStr for Simd {
    type Err = UnknownSimd;

    /// `sse4.2`, a level of earlier versions, means `portable`.
    fn from_str(text: &str) -> Result<Self, UnknownSimd> {
        if text == "sse4.2" {
            return Ok(Self::Portable);
        }
        let known = std::iter::once(Self::Auto).chain(Self::LEVELS);
        known.into_iter().find(|level| level.name() == text).ok_or_else(|| UnknownSimd(text.to_owned()))
    }
}
