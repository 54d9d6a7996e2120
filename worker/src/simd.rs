//! Selection of vector instructions, and dispatch to code compiled for them.

use std::fmt;
use std::str::FromStr;

use fearless_simd::Level;

use crate::RenderError;

/// Vector instructions to render with. All are bit-identical.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Simd {
    /// The widest level of this CPU.
    #[default]
    Auto,
    /// AVX-512: 16 lanes.
    Avx512,
    /// AVX2 and FMA: 8 lanes.
    Avx2,
    /// SSE 4.2: 4 lanes.
    Sse42,
    /// None: plain scalar code.
    Scalar,
}

impl Simd {
    /// Every level with a name, widest first.
    pub const LEVELS: [Self; 4] = [Self::Avx512, Self::Avx2, Self::Sse42, Self::Scalar];

    /// Name of the level, as flags spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Avx512 => "avx512",
            Self::Avx2 => "avx2",
            Self::Sse42 => "sse4.2",
            Self::Scalar => "scalar",
        }
    }

    /// Whether this CPU has the instructions.
    pub fn is_available(self) -> bool {
        self.level().is_ok()
    }

    /// The level itself; for `Auto`, the widest level of this CPU.
    pub fn resolve_auto(self) -> Self {
        match self {
            Self::Auto => Self::LEVELS.into_iter().find(|level| level.is_available()).unwrap_or(Self::Scalar),
            Self::Avx512 | Self::Avx2 | Self::Sse42 | Self::Scalar => self,
        }
    }

    /// Proof token that this CPU has the instructions.
    pub(crate) fn level(self) -> Result<Level, RenderError> {
        let here = Level::new();
        let level = match self {
            Self::Auto => Some(here),
            Self::Scalar => Some(Level::fallback()),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Self::Avx512 => here.as_avx512().map(Level::Avx512),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Self::Avx2 => here.as_avx2().map(Level::Avx2),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Self::Sse42 => here.as_sse4_2().map(Level::Sse4_2),
            #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
            Self::Avx512 | Self::Avx2 | Self::Sse42 => None,
        };
        level.ok_or_else(|| RenderError::Unavailable {
            requested: format!("--simd {self}"),
            reason: "its CPU does not have these instructions; use --simd auto".to_owned(),
        })
    }
}

impl fmt::Display for Simd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Compiles and runs `$body` for the instructions of a [`Level`], with their token and the number of registers
/// per packet: more registers share the cost of evaluating the scene, fewer keep the pixels of a packet
/// similar.
macro_rules! with_instructions {
    ($level:expr, $token:ident, $REGISTERS:ident => $body:expr) => {
        match $level {
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            fearless_simd::Level::Avx512($token) => $crate::simd::with_instructions!(@run $token, $REGISTERS, 2, $body),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            fearless_simd::Level::Avx2($token) => $crate::simd::with_instructions!(@run $token, $REGISTERS, 2, $body),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            fearless_simd::Level::Sse4_2($token) => $crate::simd::with_instructions!(@run $token, $REGISTERS, 2, $body),
            #[cfg(target_arch = "aarch64")]
            fearless_simd::Level::Neon($token) => $crate::simd::with_instructions!(@run $token, $REGISTERS, 4, $body),
            _ => {
                let $token = fearless_simd::Fallback::new();
                $crate::simd::with_instructions!(@run $token, $REGISTERS, 1, $body)
            }
        }
    };
    (@run $token:ident, $REGISTERS:ident, $registers:literal, $body:expr) => {{
        const $REGISTERS: usize = $registers;
        fearless_simd::Simd::vectorize($token, #[inline(always)] || $body)
    }};
}

pub(crate) use with_instructions;

/// Error returned when a name is not a SIMD level.
#[derive(Debug, thiserror::Error)]
#[error("\"{0}\" is not a SIMD level: use auto, avx512, avx2, sse4.2 or scalar")]
pub struct UnknownSimd(String);

impl FromStr for Simd {
    type Err = UnknownSimd;

    fn from_str(text: &str) -> Result<Self, UnknownSimd> {
        let known = std::iter::once(Self::Auto).chain(Self::LEVELS);
        known.into_iter().find(|level| level.name() == text).ok_or_else(|| UnknownSimd(text.to_owned()))
    }
}
