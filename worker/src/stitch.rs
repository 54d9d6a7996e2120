//! Combines a picture's tiles, a band of whole rows at a time, so that memory is needed for a band and not for
//! the picture.
//!
//! It copies floats unchanged.

use std::io::{Read, Seek};
use std::ops::Range;

use proto::Rect;

use crate::blob::{self, BlobError};
use crate::renderer::TilePixels;

/// Consecutive whole rows of a picture, with all planes.
#[derive(Debug)]
pub struct RowBand {
    rows: Range<u32>,
    width: usize,
    planes: Vec<Vec<f32>>,
}

impl RowBand {
    /// Band for pictures of this width with this many planes; empty until it is read.
    pub fn new(width: u32, planes: usize) -> Self {
        Self { rows: 0..0, width: width as usize, planes: vec![Vec::new(); planes] }
    }

    /// The rows it holds, counted from the picture's top.
    pub fn rows(&self) -> Range<u32> {
        self.rows.clone()
    }

    /// One row of one plane; the row is counted from the band's top.
    pub fn row(&self, plane: usize, row: usize) -> &[f32] {
        &self.planes[plane][row * self.width..][..self.width]
    }

    /// Band of the rows of a tile in a picture of this width; beside the tile it is 0.
    pub(crate) fn of_tile(width: u32, tile: &TilePixels) -> Self {
        let Rect { x, y, width: columns, height } = tile.rect;
        let mut band = Self::new(width, tile.planes.len());
        band.reset(y..y + height);
        for (plane, samples) in tile.planes.iter().enumerate() {
            for (row, samples) in samples.chunks_exact(columns as usize).enumerate() {
                band.row_mut(plane, row)[x as usize..][..columns as usize].copy_from_slice(samples);
            }
        }
        band
    }

    /// The planes of its rows.
    pub(crate) fn into_planes(self) -> Vec<Vec<f32>> {
        self.planes
    }

    /// One row of one plane, to be written; the row is counted from the band's top.
    pub(crate) fn row_mut(&mut self, plane: usize, row: usize) -> &mut [f32] {
        &mut self.planes[plane][row * self.width..][..self.width]
    }

    /// Makes room for these rows.
    pub(crate) fn reset(&mut self, rows: Range<u32>) {
        let length = rows.len() * self.width;
        for plane in &mut self.planes {
            plane.resize(length, 0.0);
        }
        self.rows = rows;
    }

    fn row_of_tile(&mut self, plane: usize, rect: Rect, y: u32) -> &mut [f32] {
        let start = (y - self.rows.start) as usize * self.width + rect.x as usize;
        &mut self.planes[plane][start..][..rect.width as usize]
    }
}

/// Source of a picture's rows.
pub trait RowSource: Send {
    /// Reads these rows into the band, replacing its content.
    fn read(&mut self, rows: Range<u32>, band: &mut RowBand) -> Result<(), StitchError>;
}

/// Tiles in memory.
#[derive(Clone, Copy, Debug)]
pub struct TileRows<'a>(pub &'a [TilePixels]);

impl RowSource for TileRows<'_> {
    fn read(&mut self, rows: Range<u32>, band: &mut RowBand) -> Result<(), StitchError> {
        band.reset(rows);
        let mut covered = 0;
        for tile in self.0 {
            check_shape(band, tile.rect, tile.planes.len())?;
            let shared = overlapping_rows(band, tile.rect);
            covered += shared.len() * tile.rect.width as usize;
            for (plane, samples) in tile.planes.iter().enumerate() {
                for y in shared.clone() {
                    let start = (y - tile.rect.y) as usize * tile.rect.width as usize;
                    let row = &samples[start..][..tile.rect.width as usize];
                    band.row_of_tile(plane, tile.rect, y).copy_from_slice(row);
                }
            }
        }
        check_covered(band, covered)
    }
}

/// Tile blobs, one after another in a file.
#[derive(Debug)]
pub struct BlobRows<F> {
    file: F,
    offsets: Vec<(Rect, u64)>,
    bytes: Vec<u8>,
}

impl<F: Read + Seek> BlobRows<F> {
    /// Blobs of these rectangles, each starting at its offset in the file.
    pub fn new(file: F, places: Vec<(Rect, u64)>) -> Self {
        Self { file, offsets: places, bytes: Vec::new() }
    }
}

impl<F: Read + Seek + Send> RowSource for BlobRows<F> {
    fn read(&mut self, rows: Range<u32>, band: &mut RowBand) -> Result<(), StitchError> {
        band.reset(rows);
        let mut covered = 0;
        for &(rect, start) in &self.offsets {
            let shared = overlapping_rows(band, rect);
            if shared.is_empty() {
                continue;
            }
            let unreadable = |source| StitchError::Blob { rect, source };
            let mut reader = blob::BlobReader::open_at(&mut self.file, start).map_err(unreadable)?;
            check_shape(band, reader.rect(), reader.planes())?;
            if reader.rect() != rect {
                return Err(StitchError::WrongRect { expected: rect, found: reader.rect() });
            }
            covered += shared.len() * rect.width as usize;
            for plane in 0..band.planes.len() {
                let inside = shared.start - rect.y..shared.end - rect.y;
                reader.read_rows(plane, inside, &mut self.bytes).map_err(unreadable)?;
                for (y, row) in shared.clone().zip(self.bytes.chunks_exact(rect.width as usize * size_of::<f32>())) {
                    blob::floats_from_bytes(row, band.row_of_tile(plane, rect, y));
                }
            }
        }
        check_covered(band, covered)
    }
}

fn overlapping_rows(band: &RowBand, rect: Rect) -> Range<u32> {
    let start = band.rows.start.max(rect.y);
    let end = band.rows.end.min(rect.y.saturating_add(rect.height));
    start..end.max(start)
}

fn check_shape(band: &RowBand, rect: Rect, planes: usize) -> Result<(), StitchError> {
    let fits = u64::from(rect.x) + u64::from(rect.width) <= band.width as u64;
    if fits && planes == band.planes.len() { Ok(()) } else { Err(StitchError::WrongShape { rect, planes }) }
}

fn check_covered(band: &RowBand, covered: usize) -> Result<(), StitchError> {
    if covered == band.rows.len() * band.width { Ok(()) } else { Err(StitchError::Uncovered { rows: band.rows() }) }
}

/// Error when combining tiles.
#[derive(Debug, thiserror::Error)]
pub enum StitchError {
    /// A blob could not be read.
    #[error("could not read the blob of the tile at {}, {}", rect.x, rect.y)]
    Blob {
        /// The tile.
        rect: Rect,
        /// Reason.
        #[source]
        source: BlobError,
    },
    /// A blob has another rectangle than expected.
    #[error("the blob of the tile {expected:?} has the tile {found:?}")]
    WrongRect {
        /// Expected rectangle.
        expected: Rect,
        /// Rectangle in the header.
        found: Rect,
    },
    /// A tile is outside the picture, or has other planes.
    #[error("the tile {rect:?} with {planes} planes does not fit the picture")]
    WrongShape {
        /// The tile.
        rect: Rect,
        /// Number of planes.
        planes: usize,
    },
    /// Rows are not covered exactly once.
    #[error("the tiles do not cover rows {} to {} exactly once", rows.start, rows.end)]
    Uncovered {
        /// The rows.
        rows: Range<u32>,
    },
}
