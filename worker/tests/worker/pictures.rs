//! Encoded pictures: the bytes depend on the pixels alone.

use std::io::Cursor;

use proto::Rect;
use scene::{Format, Job};
use worker::blob;
use worker::image::{EncodeThreads, ImageError, PictureSpec, Provenance, exr, png};
use worker::stitch::{BlobRows, RowSource, StitchError, TileRows};
use worker::{CancelFlag, TilePixels};

use crate::fake_renderer::{ALL_LAYERS, cut, job, pixels, transparent_job};

/// One picture of every file format.
pub(crate) fn jobs() -> Vec<Job> {
    let layers = format!(r#""format": "exr", "precision": "float", "seed": 7, "layers": {ALL_LAYERS}"#);
    vec![
        job(203, 131, ""),
        job(203, 131, r#""bits": 16"#),
        transparent_job(203, 131, r#""bits": 8"#),
        transparent_job(203, 131, r#""bits": 16"#),
        job(203, 131, r#""format": "exr""#),
        transparent_job(203, 131, &layers),
        job(1, 1, ""),
        job(1, 1, r#""format": "exr", "layers": ["depth"]"#),
    ]
}

pub(crate) fn tiles(job: &Job, rects: &[Rect]) -> Vec<TilePixels> {
    rects.iter().map(|&rect| pixels(job, 3, rect)).collect()
}

pub(crate) fn encode(job: &Job, source: &mut dyn RowSource, band_rows: u32) -> Result<Vec<u8>, ImageError> {
    let picture = PictureSpec::new(&job.at(3).unwrap());
    let mut out = Cursor::new(Vec::new());
    match picture.format {
        Format::Png => png::write(&picture, EncodeThreads::All, source, &mut out, &CancelFlag::new(), band_rows)?,
        Format::Exr => exr::write(&picture, EncodeThreads::All, source, &mut out, &CancelFlag::new(), band_rows)?,
    }
    Ok(out.into_inner())
}

#[test]
fn the_bytes_do_not_depend_on_tiles_or_bands() {
    for job in jobs() {
        let (width, height) = (job.image.width, job.image.height);
        let whole = tiles(&job, &[Rect::full(width, height)]);
        let expected = encode(&job, &mut TileRows(&whole), 64).unwrap();
        for (tile_width, tile_height) in [(32, 32), (width, 5), (17, height), (64, 23)] {
            let mut tiles = tiles(&job, &cut(width, height, tile_width, tile_height));
            tiles.reverse();
            for band_rows in [1, 7, 64, 1000] {
                let got = encode(&job, &mut TileRows(&tiles), band_rows).unwrap();
                assert_eq!(got, expected, "{tile_width}×{tile_height}, {band_rows} rows, {:?}", job.image);
                let got = encode(&job, &mut in_blobs(&tiles), band_rows).unwrap();
                assert_eq!(got, expected, "{tile_width}×{tile_height} in blobs, {band_rows} rows, {:?}", job.image);
            }
        }
    }
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    for job in jobs() {
        let tiles = tiles(&job, &[Rect::full(job.image.width, job.image.height)]);
        let picture = PictureSpec::new(&job.at(3).unwrap());
        let write = |threads| {
            let mut file = Cursor::new(Vec::new());
            picture.write_on(threads, &mut TileRows(&tiles), &mut file, &CancelFlag::new()).unwrap();
            file.into_inner()
        };
        let expected = write(EncodeThreads::All);
        assert_eq!(pool.install(|| write(EncodeThreads::All)), expected);
        assert_eq!(write(EncodeThreads::One), expected);
    }
}

#[test]
fn a_missing_tile_is_an_error() {
    for job in jobs() {
        let mut tiles = tiles(&job, &cut(job.image.width, job.image.height, 32, 32));
        tiles.pop();
        let error = encode(&job, &mut TileRows(&tiles), 64).unwrap_err();
        assert!(matches!(error, ImageError::Stitch(StitchError::Uncovered { .. })), "{error:?}");
        let error = encode(&job, &mut in_blobs(&tiles), 64).unwrap_err();
        assert!(matches!(error, ImageError::Stitch(StitchError::Uncovered { .. })), "{error:?}");
    }
}

#[test]
fn a_truncated_blob_is_an_error() {
    let job = job(64, 64, "");
    let tile = pixels(&job, 3, Rect::full(64, 64));
    let mut bytes = blob::encode(&tile);
    bytes.pop();
    let error = encode(&job, &mut BlobRows::new(Cursor::new(bytes), vec![(tile.rect, 0)]), 64).unwrap_err();
    assert!(matches!(error, ImageError::Stitch(StitchError::Blob { .. })), "{error:?}");
}

#[test]
fn a_set_cancel_flag_stops_encoding() {
    let cancel = CancelFlag::new();
    cancel.cancel();
    for job in jobs() {
        let tiles = tiles(&job, &[Rect::full(job.image.width, job.image.height)]);
        let mut out = Cursor::new(Vec::new());
        let error = PictureSpec::new(&job.at(3).unwrap()).write(&mut TileRows(&tiles), &mut out, &cancel).unwrap_err();
        assert!(matches!(error, ImageError::Cancelled), "{error:?}");
    }
}

fn in_blobs(tiles: &[TilePixels]) -> BlobRows<Cursor<Vec<u8>>> {
    let mut file = b"something before".to_vec();
    let mut places = Vec::new();
    for tile in tiles {
        places.push((tile.rect, file.len() as u64));
        blob::write(tile, &mut file).unwrap();
    }
    BlobRows::new(Cursor::new(file), places)
}

/// The compressors are dependencies: a new version must not change pictures unnoticed.
#[test]
fn the_bytes_of_a_picture_are_pinned() {
    let pinned = [
        (job(70, 50, ""), "f62461aeff344bb87c20520e18d2657ce32eacd4d5edd17dee7fcdf57acade76"),
        (transparent_job(70, 50, r#""bits": 16"#), "e56b03127e65f515b5669720d496b71717a728c789b4d2dd45d67d88e6baf3fb"),
        (
            job(70, 50, r#""format": "exr", "layers": ["depth", "object"]"#),
            "113677828cf45c2413730a0dffe667ee199f44a0b79a9b099eefd4deecdab856",
        ),
    ];
    let hashes = pinned.each_ref().map(|(job, _)| {
        let provenance = Provenance { scene: "0".repeat(64), picture_version: 1, frame: 0, seed: 0, objects: None };
        let mut picture = PictureSpec::new(&job.at(0).unwrap());
        picture.provenance = provenance;
        let tiles = tiles(job, &[Rect::full(70, 50)]);
        let mut out = Cursor::new(Vec::new());
        picture.write(&mut TileRows(&tiles), &mut out, &CancelFlag::new()).unwrap();
        blob::hash(&out.into_inner())
    });
    assert_eq!(hashes.each_ref().map(String::as_str), pinned.map(|(_, expected)| expected));
}
