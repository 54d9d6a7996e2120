//! Tile blobs: they have exactly the pixels of their tile, and damaged ones are rejected.

use std::io::Cursor;

use proto::Rect;
use worker::blob::{self, BlobError};

use crate::fake_renderer::{ALL_LAYERS, job, pixels};

fn tile() -> worker::TilePixels {
    let job = job(64, 64, &format!(r#""format": "exr", "layers": {ALL_LAYERS}"#));
    let mut tile = pixels(&job, 0, Rect { x: 32, y: 7, width: 5, height: 9 });
    tile.planes[5][..4].copy_from_slice(&[f32::INFINITY, -0.0, f32::MIN_POSITIVE / 4.0, f32::MAX]);
    tile
}

#[test]
fn a_blob_decodes_to_its_tile() {
    let tile = tile();
    let bytes = blob::encode(&tile);
    assert_eq!(bytes.len() as u64, blob::size_bytes(tile.rect, tile.planes.len()));
    let back = blob::decode(&bytes).unwrap();
    assert_eq!(back.rect, tile.rect);
    for (back, plane) in back.planes.iter().zip(&tile.planes) {
        assert!(back.iter().zip(plane).all(|(a, b)| a.to_bits() == b.to_bits()));
    }
}

#[test]
fn the_format_is_fixed() {
    let tile = worker::TilePixels { rect: Rect { x: 1, y: 2, width: 2, height: 1 }, planes: vec![vec![1.0, -2.0]] };
    let bytes = blob::encode(&tile);
    let words = [1_u32, 1, 2, 2, 1, 1, 0x3F80_0000, 0xC000_0000].map(u32::to_le_bytes).concat();
    assert_eq!(bytes, [b"sdfb".as_slice(), &words].concat());
    assert_eq!(blob::hash(b""), "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262");
}

#[test]
fn rows_are_read_without_other_rows() {
    let tile = tile();
    let mut file = b"xyz".to_vec();
    file.extend(blob::encode(&tile));
    let mut reader = blob::BlobReader::open_at(Cursor::new(file), 3).unwrap();
    let mut bytes = Vec::new();
    for (plane, samples) in tile.planes.iter().enumerate() {
        reader.read_rows(plane, 2..6, &mut bytes).unwrap();
        let mut floats = vec![0.0; 20];
        blob::floats_from_bytes(&bytes, &mut floats);
        assert_eq!(floats, samples[10..30]);
    }
}

#[test]
fn damaged_blobs_are_rejected() {
    let bytes = blob::encode(&tile());
    for length in 0..bytes.len() {
        let error = blob::decode(&bytes[..length]).unwrap_err();
        assert!(matches!(error, BlobError::Truncated), "{length}: {error}");
    }
    let longer = [bytes.as_slice(), &[0]].concat();
    assert!(matches!(blob::decode(&longer), Err(BlobError::TooLong { .. })));
    for place in 0..blob::HEADER_BYTES {
        for bit in 0..8 {
            let mut damaged = bytes.clone();
            damaged[place] ^= 1 << bit;
            if let Ok(decoded) = blob::decode(&damaged) {
                assert!((8..16).contains(&place), "only x and y may change unseen: {place} {:?}", decoded.rect);
            }
            if let Ok(mut reader) = blob::BlobReader::open_at(Cursor::new(&damaged), 0) {
                let rows = 0..reader.rect().height.min(9);
                let _truncated_or_not = reader.read_rows(0, rows, &mut Vec::new());
            }
        }
    }
}
