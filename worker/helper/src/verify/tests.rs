//! Forgeries of single bits in pictures of the shipped scenes, which must all be found, and pictures that are genuine.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::PathBuf;

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer as ExrLayer, LayerAttributes, SmallVec, Text, Vec2,
    WritableImage, f16,
};
use scene::{Bits, Format, Layer, Precision};
use worker::image::stored::{ValueKind, Values};
use worker::{CpuRenderer, Simd};

use super::*;

/// Random numbers that are the same in every run: Marsaglia, "Xorshift RNGs", 2003.
struct Rng(u64);

impl Rng {
    fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % limit
    }
}

/// Format and precision of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Png8,
    Png16,
    Half,
    Float,
}

const KINDS: [Kind; 4] = [Kind::Png8, Kind::Png16, Kind::Half, Kind::Float];

/// A small picture of a shipped scene.
struct Genuine {
    name: String,
    kind: Kind,
    job: Job,
    file: Vec<u8>,
}

/// Job files that are shipped.
fn shipped() -> Vec<PathBuf> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut paths = Vec::new();
    for folder in ["scenes", "docs/scenes", "docs/scenes/light"] {
        let entries = std::fs::read_dir(root.join(folder)).expect("the scenes are there").flatten();
        paths
            .extend(entries.map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|end| end == "json")));
    }
    paths.sort();
    paths
}

/// Renders a scene in small.
fn genuine(path: &PathBuf, kind: Kind, renderer: &CpuRenderer) -> Genuine {
    let name = path.file_stem().expect("a name").to_string_lossy().into_owned();
    let mut job = scene::parse(&std::fs::read(path).expect("readable")).expect("a valid job");
    let image = &mut job.image;
    image.resize(88, 70);
    image.samples = 1.into();
    image.clear_layers();
    (image.format, image.bits, image.precision) = match kind {
        Kind::Png8 => (Format::Png, Bits::Eight, Precision::Half),
        Kind::Png16 => (Format::Png, Bits::Sixteen, Precision::Half),
        Kind::Half => (Format::Exr, Bits::Eight, Precision::Half),
        Kind::Float => (Format::Exr, Bits::Eight, Precision::Float),
    };
    if image.format == Format::Exr {
        image.layers = vec![Layer::Depth, Layer::Normal, Layer::Object, Layer::Steps];
    }
    let file = rendered(&job, renderer);
    Genuine { name, kind, job, file }
}

/// The file of a job's picture.
fn rendered(job: &Job, renderer: &CpuRenderer) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let folder = std::env::temp_dir();
    worker::frame::render_frame(renderer, job, 0, None, &folder, &mut file, &CancelFlag::new(), &|_| ())
        .expect("rendered");
    file.into_inner()
}

impl Genuine {
    fn check(&self, file: &[u8], extent: Extent, renderer: &CpuRenderer) -> Comparison {
        let original = Original::new(&self.job, 0).expect("a valid frame");
        let stored = StoredPicture::read(file).expect("a picture");
        original.check(file, stored, extent, renderer, None, &CancelFlag::new()).expect("rendered").comparison
    }

    /// Inverts a random bit of a pixel, and writes a valid file with that pixel. Returns the pixel's place and channel.
    fn forge(&self, random: &mut Rng) -> (Vec<u8>, [u32; 2], String) {
        let mut stored = StoredPicture::read(&self.file).expect("a picture");
        let [channels, pixels] = [stored.channels.len() as u64, u64::from(stored.width) * u64::from(stored.height)];
        let (channel, index) = (random.below(channels) as usize, random.below(pixels) as usize);
        let bits = stored.channels[channel].values.width_bits();
        stored.channels[channel].values.flip(index, random.below(bits.into()) as u32);
        let place = [index as u32 % stored.width, index as u32 / stored.width];
        let file = match stored.format {
            Format::Png => stored.rewrite(&Original::new(&self.job, 0).expect("a frame").spec).expect("written"),
            Format::Exr => write_exr(&stored),
        };
        assert_eq!(StoredPicture::read(&file).expect("a valid file"), stored, "{} {:?}", self.name, self.kind);
        (file, place, stored.channels[channel].name.clone())
    }
}

/// Writes these very bits, also where sdfarm never would: NaN and −0.
fn write_exr(stored: &StoredPicture) -> Vec<u8> {
    let channels = stored.channels.iter().map(|channel| {
        let samples = match &channel.values {
            Values::Words(values) => FlatSamples::F16(values.iter().map(|&bits| f16::from_bits(bits)).collect()),
            Values::Longs(values) => FlatSamples::F32(values.iter().map(|&bits| f32::from_bits(bits)).collect()),
            Values::Bytes(_) => unreachable!("an EXR has no bytes"),
        };
        AnyChannel::new(channel.name.as_str(), samples)
    });
    let channels: SmallVec<[AnyChannel<FlatSamples>; 4]> = channels.collect();
    let mut attributes = LayerAttributes::default();
    if let FoundProvenance::Known(provenance) = &stored.provenance {
        let text = exr::meta::attribute::AttributeValue::Text(Text::new_or_panic(provenance.json()));
        attributes.other.insert(Text::new_or_panic("sdfarm"), text);
    }
    let size = Vec2(stored.width as usize, stored.height as usize);
    let layer = ExrLayer::new(size, attributes, Encoding::SMALL_LOSSLESS, AnyChannels::sort(channels));
    let mut file = Cursor::new(Vec::new());
    Image::from_layer(layer).write().non_parallel().to_buffered(&mut file).expect("written");
    file.into_inner()
}

/// Forges pictures of these scenes in turn, and expects each forgery to be found where it is.
fn find_forgeries(paths: &[PathBuf], count: u64) {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("threads");
    let mut random = Rng::new(18);
    let mut pictures: BTreeMap<(usize, Kind), Genuine> = BTreeMap::new();
    for number in 0..count as usize {
        let (place, kind) = (number / KINDS.len() % paths.len(), KINDS[number % KINDS.len()]);
        let genuine = pictures.entry((place, kind)).or_insert_with(|| genuine(&paths[place], kind, &renderer));
        let (file, [x, y], channel) = genuine.forge(&mut random);
        let found = genuine.check(&file, Extent::All, &renderer);
        let context = format!("{} {kind:?}, {channel} of ({x}, {y}): {found:?}", genuine.name);
        assert!(!found.pixels_same && !found.is_same(), "{context}");
        assert_eq!((found.pixels_different, found.differs.len(), found.tiles_checked), (1, 1, 4), "{context}");
        let first = &found.differs[0].first;
        assert_eq!((first.x, first.y, &first.channel), (x, y, &channel), "{context}");
        assert_eq!([found.differs[0].x, found.differs[0].y], [x / TILE_PX * TILE_PX, y / TILE_PX * TILE_PX]);
    }
}

/// Verifies pictures of these scenes, and expects no alarm.
fn accept_genuine(paths: &[PathBuf]) {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("threads");
    for path in paths {
        for kind in KINDS {
            let genuine = genuine(path, kind, &renderer);
            for extent in [Extent::All, Extent::Sample(2)] {
                let found = genuine.check(&genuine.file, extent, &renderer);
                assert!(found.is_same() && found.findings.is_empty(), "{} {kind:?}: {found:?}", genuine.name);
            }
        }
    }
}

fn some() -> Vec<PathBuf> {
    let wanted = ["csg.json", "joins.json", "textures.json"];
    shipped().into_iter().filter(|path| wanted.iter().any(|name| path.ends_with(name))).collect()
}

#[test]
fn every_forged_bit_of_some_scenes_is_found() {
    assert_eq!(some().len(), 3);
    find_forgeries(&some(), 100);
    accept_genuine(&some());
}

#[test]
#[ignore = "long: 1,000 forgeries in pictures of all shipped scenes, and all of those without one; 5 min"]
fn every_forged_bit_of_all_scenes_is_found() {
    let paths = shipped();
    assert!(paths.len() > 40, "{}", paths.len());
    find_forgeries(&paths, 1000);
    accept_genuine(&paths);
}

/// The denoiser reads pixels beyond a tile.
#[test]
fn single_tiles_of_a_denoised_picture_are_verified() {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("threads");
    let mut genuine = genuine(&some()[0], Kind::Half, &renderer);
    let image = &mut genuine.job.image;
    image.resize(330, 250);
    let adaptive = serde_json::json!({ "adaptive": { "min": 4, "max": 16 } });
    (image.samples, image.denoise) = (serde_json::from_value(adaptive).expect("a valid number"), true);
    image.layers = vec![Layer::Samples, Layer::Noisy];
    genuine.file = rendered(&genuine.job, &renderer);
    for extent in [Extent::All, Extent::Sample(6)] {
        let found = genuine.check(&genuine.file, extent, &renderer);
        assert!(found.is_same() && found.findings.is_empty(), "{extent:?}: {found:?}");
    }
    let (file, [x, y], _) = genuine.forge(&mut Rng::new(5));
    let found = genuine.check(&file, Extent::All, &renderer);
    assert_eq!((found.pixels_different, [found.differs[0].first.x, found.differs[0].first.y]), (1, [x, y]));
}

#[test]
fn sample_says_nothing_of_tiles_that_it_left_out() {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("threads");
    let genuine = genuine(&some()[0], Kind::Png8, &renderer);
    let (file, place, _) = genuine.forge(&mut Rng::new(1));
    let mut found = [0, 0];
    for _ in 0..60 {
        let sample = genuine.check(&file, Extent::Sample(2), &renderer);
        assert_eq!((sample.tiles_checked, sample.tiles_total), (2, 4));
        found[usize::from(!sample.pixels_same)] += 1;
    }
    // Half of the tiles are checked each time: both happen 60 times in a row once in 10¹⁸ runs.
    assert!(found[0] > 0 && found[1] > 0, "{found:?} for {place:?}");
}

#[test]
fn every_other_change_of_a_file_is_named() {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("threads");
    let genuine = genuine(&some()[0], Kind::Png8, &renderer);
    let decoded = image::load_from_memory_with_format(&genuine.file, image::ImageFormat::Png).expect("a PNG");
    let named = |file: &[u8], same_pixels: bool, words: &str| {
        let found = genuine.check(file, Extent::All, &renderer);
        assert!(!found.is_same(), "{words}");
        assert_eq!(found.pixels_same, same_pixels, "{found:?}");
        assert!(found.findings.iter().any(|finding| finding.contains(words)), "{words}: {found:?}");
    };
    // Encoded again by another program, which drops metadata; with an alpha channel that is opaque.
    for picture in [decoded.clone(), image::DynamicImage::ImageRgba8(decoded.to_rgba8())] {
        let mut other = Cursor::new(Vec::new());
        picture.write_to(&mut other, image::ImageFormat::Png).expect("encoded");
        named(other.get_ref(), true, "no provenance");
    }
    let mut longer = genuine.file.clone();
    longer.extend(b"more");
    named(&longer, true, "another program encoded it again");
    let mut small = Cursor::new(Vec::new());
    decoded.crop_imm(0, 0, 80, 70).write_to(&mut small, image::ImageFormat::Png).expect("encoded");
    named(small.get_ref(), false, "80×70 pixels");
    // The provenance of another scene, frame and seed.
    let stored = StoredPicture::read(&genuine.file).expect("a picture");
    for (change, words) in [
        ((|provenance| provenance.scene = "0".repeat(64)) as fn(&mut Provenance), "says scene"),
        (|provenance| provenance.frame = 7, "says frame 7"),
        (|provenance| provenance.seed = 9, "says seed 9"),
        (|provenance| provenance.picture_version -= 1, "says picture version"),
    ] {
        let mut spec = Original::new(&genuine.job, 0).expect("a frame").spec;
        change(&mut spec.provenance);
        named(&stored.rewrite(&spec).expect("written"), true, words);
    }
}

#[test]
fn what_is_no_complete_picture_is_told() {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("threads");
    for kind in KINDS {
        let file = genuine(&some()[0], kind, &renderer).file;
        for length in [9, file.len() / 2, file.len() - 20] {
            let error = StoredPicture::read(&file[..length]).expect_err("it is cut");
            assert!(!matches!(error, UnreadablePicture::NotAPicture), "{kind:?} {length}: {error}");
        }
        let mut damaged = file.clone();
        let middle = file.len() / 2;
        damaged[middle..middle + 8].iter_mut().for_each(|byte| *byte ^= 0x5a);
        let read = StoredPicture::read(&damaged);
        assert!(read.is_err() || read.is_ok_and(|read| read != StoredPicture::read(&file).expect("a picture")));
    }
    for file in [&b""[..], b"GIF89a", b"{}"] {
        assert!(matches!(StoredPicture::read(file), Err(UnreadablePicture::NotAPicture)));
    }
}

#[test]
fn a_forged_pixel_is_red_in_the_picture_of_differences() {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("threads");
    let genuine = genuine(&some()[0], Kind::Float, &renderer);
    let (file, [x, y], _) = genuine.forge(&mut Rng::new(3));
    let original = Original::new(&genuine.job, 0).expect("a frame");
    let stored = StoredPicture::read(&file).expect("a picture");
    let checked =
        original.check(&file, stored.clone(), Extent::All, &renderer, None, &CancelFlag::new()).expect("rendered");
    let drawn = image::load_from_memory(&draw(&stored, &checked).expect("drawn")).expect("a PNG").into_rgb8();
    assert_eq!(drawn.dimensions(), (stored.width, stored.height));
    assert_eq!(drawn.get_pixel(x, y).0, [255, 40, 60]);
    assert!(stored.channels.iter().any(|channel| channel.kind == ValueKind::Float));
}
