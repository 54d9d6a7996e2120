//! Encodes pictures as files: describes a picture, and calls the encoder of its format.
//!
//! The bytes depend on the pixels and the provenance alone, never on tiles, bands or threads.

pub mod encoders;
pub mod exr;
pub mod metadata;
pub mod png;
pub mod stored;

use std::borrow::Cow;
use std::io::{self, Seek, Write};

use proto::Rect;

use ::scene::film::DisplayTransform;
use ::scene::mattes::Matte;
use ::scene::sample_count::BLOCK_PX;
use ::scene::{Bits, Format, JobAtFrame, Precision};

pub use encoders::{EncodeThreads, Encoders};
pub use metadata::Metadata;
pub use scene::Provenance;

/// Name of the PNG chunk and of the EXR attribute that store a picture's provenance.
pub const PROVENANCE_KEYWORD: &str = "sdfarm";

use tape::InvalidTape;

use crate::finish::{Finish, FinishedRows};
use crate::renderer::{CancelFlag, TilePixels};
use crate::stitch::{RowSource, StitchError};

/// Everything about a picture except its pixels.
#[derive(Clone, Debug)]
pub struct PictureSpec {
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
    /// Names of the planes, R G B A first.
    pub channels: Vec<Cow<'static, str>>,
    /// Number of the planes of light, which come first: R G B A, and the light groups'.
    pub light_channels: usize,
    /// The file format.
    pub format: Format,
    /// Bits per channel of a PNG.
    pub bits: Bits,
    /// Precision of light in an EXR.
    pub precision: Precision,
    /// Display transform of a PNG.
    pub display_transform: DisplayTransform,
    /// Alpha is 1 in every pixel.
    pub opaque: bool,
    /// How its planes are finished, unless they are as rendered.
    finish: Option<Finish>,
    /// Mattes among the planes, for the header of an EXR.
    pub mattes: Vec<Matte>,
    /// Camera matrices and frame rate for the header of an EXR.
    pub metadata: Metadata,
    /// Provenance.
    pub provenance: Provenance,
}

impl PictureSpec {
    /// Picture settings of a job at a frame.
    pub fn new(at_frame: &JobAtFrame<'_>) -> Self {
        let image = at_frame.image();
        let film = image.film();
        Self {
            width: film.width,
            height: film.height,
            channels: film.channels(),
            light_channels: film.light_channels(),
            format: image.format,
            bits: image.bits,
            precision: image.precision,
            display_transform: DisplayTransform::new(image),
            opaque: !at_frame.scene().is_transparent(),
            finish: Finish::of(image),
            mattes: at_frame.mattes(),
            metadata: Metadata::new(at_frame),
            provenance: Provenance::new(at_frame),
        }
    }

    /// The pixels that must be rendered for a rectangle: more if finishing them reads their neighbors.
    pub fn rendered_for(&self, rect: Rect) -> Rect {
        let Some(finish) = self.finish else { return rect };
        // Blocks of adaptive samples begin at multiples of their size.
        let reach = finish.margin_px().next_multiple_of(BLOCK_PX);
        let (x, y) = (rect.x.saturating_sub(reach), rect.y.saturating_sub(reach));
        let end = |start: u32, length: u32, edge: u32| {
            (start + length).next_multiple_of(BLOCK_PX).saturating_add(reach).min(edge)
        };
        let (right, bottom) = (end(rect.x, rect.width, self.width), end(rect.y, rect.height, self.height));
        Rect { x, y, width: right - x, height: bottom - y }
    }

    /// The pixels of a rectangle, from the pixels of [`Self::rendered_for`].
    pub fn finished_tile(&self, rendered: TilePixels, rect: Rect) -> TilePixels {
        match self.finish {
            None => rendered,
            Some(finish) => finish.finished_tile(rendered, rect),
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
        let mut finished;
        let source = match self.finish {
            None => source,
            Some(finish) => {
                finished = FinishedRows::new(source, finish, [self.width, self.height]);
                &mut finished
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
