//! Fuzzes tile blobs, and pictures that are written and read back.

use std::io::Cursor;

use proto::Rect;
use serde_json::json;
use worker::blob;
use worker::image::PictureSpec;
use worker::stitch::TileRows;
use worker::{CancelFlag, TilePixels};

use super::{Effort, fuzz};
use crate::jobs;

/// Creates a tile with these planes and varied samples.
fn tile(rect: Rect, planes: usize) -> TilePixels {
    let samples = |plane: usize| (0..rect.pixels()).map(move |pixel| (pixel as f32 - 7.5) * (plane as f32).exp2());
    TilePixels { rect, planes: (0..planes).map(|plane| samples(plane).collect()).collect() }
}

/// A blob must decode to the value it was encoded from, or be rejected.
fn try_blobs(effort: Effort) {
    let shapes = [(0, 0, 1, 1, 4), (32, 64, 5, 3, 4), (0, 0, 8, 8, 7), (65_000, 0, 16, 2, 64)];
    let corpus: Vec<Vec<u8>> =
        shapes.map(|(x, y, width, height, planes)| blob::encode(&tile(Rect { x, y, width, height }, planes))).to_vec();
    fuzz("blobs", effort, &corpus, |bytes| {
        let whole = blob::decode(bytes);
        if let Ok(pixels) = &whole {
            assert_eq!(blob::encode(pixels), bytes, "decoding and encoding changed the blob");
        }
        if let Ok(mut reader) = blob::BlobReader::open_at(Cursor::new(bytes), 0) {
            let (rows, last) = (reader.rect().height, reader.planes() - 1);
            // A header may declare more rows than exist; they are rejected before memory is allocated for them.
            if u64::from(rows) * u64::from(reader.rect().width) <= bytes.len() as u64 {
                let mut read = Vec::new();
                let got = reader.read_rows(last, 0..rows, &mut read);
                assert!(got.is_ok() || whole.is_err(), "a complete blob is also read in bands");
            }
        }
    });
}

#[test]
fn fuzzed_blobs_are_decoded_or_rejected() {
    try_blobs(Effort::Runs(2000));
}

#[test]
#[ignore = "long: fuzzing for 60 s"]
fn long_fuzzed_blobs_are_decoded_or_rejected() {
    try_blobs(Effort::Long);
}

const SIZE: Rect = Rect { x: 0, y: 0, width: 9, height: 5 };

/// Job of a small picture in this format.
pub(super) fn job(image: serde_json::Value) -> scene::Job {
    let mut job = jobs::quick();
    job["image"] = image;
    job["image"]["width"] = SIZE.width.into();
    job["image"]["height"] = SIZE.height.into();
    scene::parse(job.to_string().as_bytes()).expect("a valid job")
}

/// Creates a tile whose samples repeat these bytes, without NaN, which a renderer never returns.
pub(super) fn tile_of(bytes: &[u8], planes: usize) -> TilePixels {
    let floats: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect();
    let sound = floats.into_iter().map(|sample| if sample.is_nan() { 0.5 } else { sample }).chain([0.25]);
    let mut samples = sound.collect::<Vec<_>>().into_iter().cycle();
    let pixels = SIZE.pixels() as usize;
    TilePixels { rect: SIZE, planes: (0..planes).map(|_| samples.by_ref().take(pixels).collect()).collect() }
}

pub(super) fn written(job: &scene::Job, tile: TilePixels) -> Vec<u8> {
    let picture = PictureSpec::new(&job.at(0).expect("a first frame"));
    let mut out = Cursor::new(Vec::new());
    picture.write(&mut TileRows(&[tile]), &mut out, &CancelFlag::new()).expect("any samples can be written");
    out.into_inner()
}

pub(super) fn samples() -> Vec<Vec<u8>> {
    let sorts =
        [0.0, -0.0, 1.0, 0.5, -1.0, 1e-40, 1e-8, 65504.0, 65520.0, 1e30, f32::INFINITY, f32::NEG_INFINITY, f32::MAX];
    let all: Vec<u8> = sorts.iter().flat_map(|sample: &f32| sample.to_le_bytes()).collect();
    vec![all.clone(), all[..16].to_vec(), all.repeat(20)]
}

fn try_png(effort: Effort) {
    let jobs = [job(json!({ "format": "png" })), job(json!({ "format": "png", "bits": 16 }))];
    fuzz("PNG", effort, &samples(), |bytes| {
        for job in &jobs {
            let file = written(job, tile_of(bytes, job.image.film().channels().len()));
            let mut reader = png::Decoder::new(Cursor::new(&file)).read_info().expect("a PNG");
            let mut pixels = vec![0; reader.output_buffer_size().expect("small")];
            let frame = reader.next_frame(&mut pixels).expect("a complete PNG");
            assert_eq!((frame.width, frame.height), (SIZE.width, SIZE.height));
            reader.finish().expect("a PNG's end");
            assert!(reader.info().utf8_text.iter().any(|text| text.keyword == "sdfarm"), "it has the provenance text");
        }
    });
}

#[test]
fn fuzzed_samples_are_written_as_png_and_read_back() {
    try_png(Effort::Runs(300));
}

#[test]
#[ignore = "long: fuzzing for 60 s"]
fn long_fuzzed_samples_are_written_as_png_and_read_back() {
    try_png(Effort::Long);
}

fn try_exr(effort: Effort) {
    use exr::prelude::{ReadChannels, ReadLayers};
    let job = job(json!({ "format": "exr", "precision": "float", "layers": ["depth", "normal"] }));
    fuzz("EXR", effort, &samples(), |bytes| {
        let tile = tile_of(bytes, job.image.film().channels().len());
        let file = written(&job, tile.clone());
        let image = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .from_buffered(Cursor::new(&file))
            .expect("a complete EXR");
        let channels = &image.layer_data.channel_data.list;
        assert_eq!(channels.len(), tile.planes.len());
        for (name, plane) in job.image.film().channels().iter().zip(&tile.planes) {
            let channel = channels.iter().find(|channel| channel.name.to_string() == *name).expect("every channel");
            let read: Vec<f32> = channel.sample_data.values_as_f32().collect();
            let alike = read.iter().zip(plane).all(|(read, wrote)| read == wrote);
            assert!(alike && read.len() == plane.len(), "{name}: {read:?} is not {plane:?}");
        }
    });
}

#[test]
fn fuzzed_samples_are_written_as_exr_and_read_back() {
    try_exr(Effort::Runs(300));
}

#[test]
#[ignore = "long: fuzzing for 60 s"]
fn long_fuzzed_samples_are_written_as_exr_and_read_back() {
    try_exr(Effort::Long);
}
