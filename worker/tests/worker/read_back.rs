//! Pictures as other programs read them.

use std::io::{Cursor, Write};
use std::process::{Command, Stdio};

use half::f16;
use proto::Rect;
use scene::values::ExposureStops;
use scene::{Bits, ImageSpec, Job, Precision, ToneMap};
use worker::TilePixels;
use worker::stitch::TileRows;

use crate::fake_renderer::{ALL_LAYERS, job, transparent_job};
use crate::pictures::{encode, jobs, tiles};

fn whole(job: &Job) -> TilePixels {
    tiles(job, &[Rect::full(job.image.width, job.image.height)]).remove(0)
}

fn file(job: &Job, pixels: &TilePixels) -> Vec<u8> {
    encode(job, &mut TileRows(std::slice::from_ref(pixels)), 64).unwrap()
}

fn pngs() -> impl Iterator<Item = Job> {
    jobs().into_iter().filter(|job| job.image.format == scene::Format::Png)
}

fn exrs() -> impl Iterator<Item = Job> {
    jobs().into_iter().filter(|job| job.image.format == scene::Format::Exr)
}

struct DecodedPng {
    info: png::Info<'static>,
    bytes: Vec<u8>,
}

fn decode_png(bytes: &[u8]) -> DecodedPng {
    let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    reader.finish().unwrap();
    DecodedPng { info: reader.info().clone(), bytes: pixels }
}

/// The IEC 61966-2-1 curve, in double precision.
#[expect(clippy::disallowed_methods, reason = "the reference must not use the code under test")]
fn srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// A PNG of each kind with a display transform: two stops brighter and filmic, or half a stop darker alone.
fn graded() -> impl Iterator<Item = Job> {
    pngs().flat_map(|job| {
        let filmic =
            ImageSpec { exposure: ExposureStops::new(2.0).unwrap(), tone_map: ToneMap::Filmic, ..job.image.clone() };
        let darker = ImageSpec { exposure: ExposureStops::new(-0.5).unwrap(), ..job.image.clone() };
        [filmic, darker].map(|image| job.clone().with_image(image))
    })
}

/// Displayed value of linear light, in double precision.
#[expect(clippy::disallowed_methods, reason = "the reference must not use the code under test")]
fn shown(image: &ImageSpec, linear: f64) -> f64 {
    let x = linear * f64::from(image.exposure.in_frame()).exp2();
    match image.tone_map {
        ToneMap::None => x,
        ToneMap::Filmic => x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14),
    }
}

#[test]
fn a_png_has_the_srgb_values_of_its_displayed_pixels() {
    for job in pngs().chain(graded()) {
        let pixels = whole(&job);
        let decoded = decode_png(&file(&job, &pixels));
        let alpha_plane = decoded.info.color_type == png::ColorType::Rgba;
        let channels = if alpha_plane { 4 } else { 3 };
        let (wide, top) = match job.image.bits {
            Bits::Eight => (1, 255.0),
            Bits::Sixteen => (2, 65535.0),
        };
        let samples: Vec<f64> = decoded
            .bytes
            .chunks(wide)
            .map(|bytes| match *bytes {
                [one] => f64::from(one),
                [high, low] => f64::from(u16::from_be_bytes([high, low])),
                _ => unreachable!("one byte or two"),
            })
            .collect();
        assert_eq!(samples.len(), pixels.planes[0].len() * channels);
        for (index, pixel) in samples.chunks(channels).enumerate() {
            let alpha = if alpha_plane { f64::from(pixels.planes[3][index]) } else { 1.0 };
            for (value, plane) in pixel[..3].iter().zip(&pixels.planes) {
                let linear = shown(&job.image, f64::from(plane[index]) / alpha);
                let exact = srgb(linear.clamp(0.0, 1.0)) * top;
                // Half a step of rounding, or one of the two levels around it if there is dither; plus the
                // error of single precision before it.
                let step = match job.image.bits {
                    Bits::Eight => 1.0,
                    Bits::Sixteen => 0.5,
                };
                assert!((value - exact).abs() <= step + top * 1e-6, "{value} for {exact}");
            }
            if alpha_plane {
                assert_eq!(pixel[3], (alpha * top + 0.5).floor());
            }
        }
    }
}

#[test]
fn a_png_is_tagged_srgb_and_has_its_provenance() {
    for job in pngs() {
        let info = decode_png(&file(&job, &whole(&job))).info;
        assert!(info.srgb.is_some());
        let texts: Vec<_> =
            info.utf8_text.iter().map(|chunk| (chunk.keyword.as_str(), chunk.get_text().unwrap())).collect();
        assert_eq!(texts, [("sdfarm", expected_provenance(&job))]);
        assert!(info.uncompressed_latin1_text.is_empty() && info.compressed_latin1_text.is_empty());
    }
}

fn expected_provenance(job: &Job) -> String {
    let hash = job.at(0).unwrap().scene_hash();
    let (scene, version, seed) = (hash.to_hex(), scene::PICTURE_VERSION, job.image.seed);
    format!(r#"{{"scene":"{scene}","picture_version":{version},"frame":3,"seed":{seed}}}"#)
}

#[test]
fn an_independent_reader_decodes_the_same_png() {
    let python = Command::new("python3").arg("--version").stdout(Stdio::null()).status();
    if !python.is_ok_and(|status| status.success()) {
        eprintln!("python3 is missing: the independent PNG reader was NOT run");
        return;
    }
    for job in pngs() {
        let bytes = file(&job, &whole(&job));
        let mut child = Command::new("python3")
            .args(["-c", include_str!("read_png.py")])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(&bytes).unwrap();
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success());
        assert_eq!(output.stdout, decode_png(&bytes).bytes);
    }
}

pub(crate) fn decode_exr(bytes: &[u8]) -> exr::image::FlatImage {
    use exr::prelude::*;
    read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .pedantic()
        .from_buffered(Cursor::new(bytes))
        .unwrap()
}

#[test]
fn an_exr_has_exactly_its_pixels() {
    for job in exrs() {
        let pixels = whole(&job);
        let image = decode_exr(&file(&job, &pixels));
        let [layer] = image.layer_data.as_slice() else { panic!("one layer") };
        let channels = &layer.channel_data.list;
        assert!(channels.is_sorted_by_key(|channel| channel.name.to_string()));
        assert_eq!(channels.len(), pixels.planes.len());
        for (index, (name, plane)) in job.image.film().channels().iter().zip(&pixels.planes).enumerate() {
            let channel = channels.iter().find(|channel| channel.name.to_string() == *name).unwrap();
            let half = index < job.image.film().light_channels() && job.image.precision == Precision::Half;
            match &channel.sample_data {
                exr::image::FlatSamples::F16(samples) => {
                    assert!(half);
                    assert!(samples.iter().zip(plane).all(|(half, &full)| *half == f16::from_f32(full)));
                }
                exr::image::FlatSamples::F32(samples) => {
                    assert!(!half);
                    assert!(samples.iter().zip(plane).all(|(a, b)| a.to_bits() == (b + 0.0).to_bits()), "{name}");
                }
                exr::image::FlatSamples::U32(_) => panic!("{name} is an integer"),
            }
        }
    }
}

#[test]
fn an_exr_has_its_provenance_and_nothing_else() {
    for job in exrs() {
        let image = decode_exr(&file(&job, &whole(&job)));
        let attributes = &image.layer_data[0].attributes;
        let expected = exr::meta::attribute::AttributeValue::Text(expected_provenance(&job).as_str().into());
        assert_eq!(attributes.other.iter().collect::<Vec<_>>(), [(&"sdfarm".into(), &expected)]);
        assert!(image.attributes.other.is_empty());
    }
}

#[test]
fn an_exr_has_its_primaries_camera_and_frame_rate() {
    for job in exrs() {
        let image = decode_exr(&file(&job, &whole(&job)));
        let attributes = &image.layer_data[0].attributes;
        let view = job.at(3).unwrap().scene().camera.view(job.image.width, job.image.height);
        assert_eq!(attributes.world_to_camera, Some(view.world_to_camera()));
        assert_eq!(attributes.world_to_normalized_device, view.world_to_ndc());
        assert_eq!(attributes.frames_per_second, Some((24, 1)));
        let colors = image.attributes.chromaticities.expect("chromaticities");
        assert_eq!((colors.red.0, colors.white.1), (0.64, 0.329));
    }
}

#[test]
fn an_exr_has_the_same_bytes_each_time() {
    let job = exrs().next().unwrap();
    let pixels = whole(&job);
    let first = file(&job, &pixels);
    assert!((0..50).all(|_| file(&job, &pixels) == first), "the order of the header's attributes changes");
}

#[test]
fn an_exr_has_no_negative_zero_and_no_nan() {
    let layers = format!(r#""format": "exr", "precision": "float", "layers": {ALL_LAYERS}"#);
    for job in [transparent_job(4, 1, &layers), transparent_job(4, 1, r#""format": "exr""#)] {
        let planes = vec![vec![-0.0, f32::NAN, -1e-12, 1e9]; job.image.film().channels().len()];
        let image = decode_exr(&file(&job, &TilePixels { rect: Rect::full(4, 1), planes }));
        for channel in &image.layer_data[0].channel_data.list {
            let bits: Vec<u32> = channel.sample_data.values_as_f32().map(f32::to_bits).collect();
            let half = matches!(channel.sample_data, exr::image::FlatSamples::F16(_));
            let [small, large] = if half { [0.0, f32::INFINITY] } else { [-1e-12, 1e9_f32] };
            assert_eq!(bits, [0, 0, small.to_bits(), large.to_bits()], "{}", channel.name);
        }
    }
}

#[test]
fn halves_round_to_the_nearest_even() {
    let job = job(4, 1, r#""format": "exr""#);
    let step = 1.0 / 1024.0;
    let row = vec![1.0 + step * 0.5, 1.0 + step * 1.5, 1.0 + step * 0.501, 65519.0];
    let image = decode_exr(&file(&job, &TilePixels { rect: Rect::full(4, 1), planes: vec![row; 4] }));
    let values: Vec<f32> = image.layer_data[0].channel_data.list[0].sample_data.values_as_f32().collect();
    assert_eq!(values, [1.0, 1.0 + step * 2.0, 1.0 + step, 65504.0]);
}
