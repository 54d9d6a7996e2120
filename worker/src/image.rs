//! Encodes pictures as files: describes a picture, and calls the encoder of its format.
//!
//! The bytes depend on the pixels and the provenance alone, never on tiles, bands or threads.

pub mod encoders;
pub mod exr;
pub mod metadata;
pub mod png;
pub mod stored;

use std::io::{self, Seek, Write};

use proto::Rect;

use ::scene::color::DisplayTransform;
use ::scene::mattes::Matte;
use ::scene::sample_count::BLOCK_PX;
use ::scene::{Bits, Format, JobAtFrame, Precision};

pub use encoders::{EncodeThreads, Encoders};
pub use metadata::Metadata;
pub use scene::Provenance;

/// Name of the PNG chunk and of the EXR attribute that store a picture's provenance.
pub const PROVENANCE_KEYWORD: &str = "sdfarm";

use crate::denoise::{DenoisedPlanes, DenoisedRows, MARGIN_PX};
use crate::renderer::{CancelFlag, TilePixels};
use crate::stitch::{RowSource, StitchError};
use crate::tape::InvalidTape;

/// Everything about a picture except its pixels.
#[derive(Clone, Debug)]
pub struct PictureSpec {
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
    /// Names of the planes, R G B A first.
    pub channels: Vec<&'static str>,
    /// The file format.
    pub format: Format,
    /// Bits per channel of a PNG.
    pub bits: Bits,
    /// Precision of R G B A in an EXR.
    pub precision: Precision,
    /// Display transform of a PNG.
    pub display_transform: DisplayTransform,
    /// Alpha is 1 in every pixel.
    pub opaque: bool,
    /// The planes that the denoiser reads and replaces, if the picture is denoised.
    denoised: Option<DenoisedPlanes>,
    /// Mattes among the planes, for the header of an EXR.
    pub mattes: Vec<Matte>,
    /// Camera matrices and frame rate for the header of an EXR.
    pub metadata: Metadata,
    /// Provenance.
    pub provenance: Provenance,
}

impl PictureSpec {
    /// Picture settings of a job at a frame.
    pub fn new(still: &JobAtFrame<'_>) -> Self {
        let image = still.image();
        Self {
            width: image.width,
            height: image.height,
            channels: image.channels(),
            format: image.format,
            bits: image.bits,
            precision: image.precision,
            display_transform: DisplayTransform::new(image),
            opaque: !still.scene().is_transparent(),
            denoised: DenoisedPlanes::of(image),
            mattes: still.mattes(),
            metadata: Metadata::new(still),
            provenance: Provenance::new(still),
        }
    }

    /// The pixels that must be rendered for those of a rectangle: more if the denoiser reads its neighbors.
    pub fn rendered_for(&self, rect: Rect) -> Rect {
        if self.denoised.is_none() {
            return rect;
        }
        // Blocks of adaptive samples begin at multiples of their size.
        let reach = MARGIN_PX.next_multiple_of(BLOCK_PX);
        let (x, y) = (rect.x.saturating_sub(reach), rect.y.saturating_sub(reach));
        let end = |start: u32, length: u32, edge: u32| {
            (start + length).next_multiple_of(BLOCK_PX).saturating_add(reach).min(edge)
        };
        let (right, bottom) = (end(rect.x, rect.width, self.width), end(rect.y, rect.height, self.height));
        Rect { x, y, width: right - x, height: bottom - y }
    }

    /// The pixels of a rectangle, from those of [`Self::rendered_for`].
    pub fn finished_tile(&self, rendered: TilePixels, rect: Rect) -> TilePixels {
        match self.denoised {
            None => rendered,
            Some(planes) => planes.finished_tile(rendered, rect),
        }
    }

    /// Writes the file, reading its rows from `source` a band at a time, on all threads of the pool on which it
    /// is called.
    pub fn write(
        &self,
        source: &mut dyn RowSource,
        out: &mut (impl Write + Seek + Send),
        cancel: &CancelFlag,
    ) -> Result<(), ImageError> {
        self.write_on(EncodeThreads::All, source, out, cancel)
    }

    /// Writes the file like [`Self::write`], on these threads of the pool.
    pub fn write_on(
        &self,
        threads: EncodeThreads,
        source: &mut dyn RowSource,
        out: &mut (impl Write + Seek + Send),
        cancel: &CancelFlag,
    ) -> Result<(), ImageError> {
        let mut denoised;
        let source = match self.denoised {
            None => source,
            Some(planes) => {
                denoised = DenoisedRows::new(source, planes, self.width);
                &mut denoised
            }
        };
        match self.format {
            Format::Png => png::write(self, threads, source, out, cancel, png::band_rows(threads)),
            Format::Exr => exr::write(self, threads, source, out, cancel, exr::band_rows(self, threads)),
        }
    }
}

/// Error when writing a picture.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The render was cancelled.
    #[error("the picture was cancelled")]
    Cancelled,
    /// A tile's rows could not be read.
    #[error("could not read the picture's tiles")]
    Stitch(#[from] StitchError),
    /// The file could not be written.
    #[error("could not write the picture")]
    Io(#[from] io::Error),
    /// The job is invalid at this frame.
    #[error("the job is invalid in this frame")]
    Frame(#[from] ::scene::FrameError),
    /// The display transform was recorded wrongly.
    #[error("the recorded formulas are invalid, which is a fault of sdfarm")]
    InvalidTape(#[from] InvalidTape),
    /// The format cannot represent the picture.
    #[error("could not encode the picture: {0}")]
    Format(String),
}

impl From<::png::EncodingError> for ImageError {
    fn from(error: ::png::EncodingError) -> Self {
        match error {
            ::png::EncodingError::IoError(error) => Self::Io(error),
            other => Self::Format(other.to_string()),
        }
    }
}

impl From<::exr::error::Error> for ImageError {
    fn from(error: ::exr::error::Error) -> Self {
        match error {
            ::exr::error::Error::Io(error) => Self::Io(error),
            other => Self::Format(other.to_string()),
        }
    }
}
