//! Cache keys: if a field of the job schema is changed in a job that uses it, the picture's cache key changes
//! exactly if the picture's bytes change. A field that no job here covers fails the test.

mod corpus;
mod schema;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use proto::Rect;
use serde_json::{Value, json};
use worker::cuda::KernelSource;
use worker::image::PictureSpec;
use worker::stitch::TileRows;
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TileRequest};

use schema::{Position, Schema};

/// Rendered frame: neither the first, where a track is at its start, nor the last.
const FRAME: u32 = 1;

/// Pixels and keys of a job's frame.
struct Shot {
    /// Bits of every plane, and the names of the planes.
    pixels: (Vec<Cow<'static, str>>, Vec<u32>),
    bytes: Vec<u8>,
    key: String,
    pixels_key: String,
    scene_hash: String,
}

/// Renders a job; `None` if the job is invalid.
fn shot(renderer: &CpuRenderer, job: &Value) -> Option<Shot> {
    let job = scene::parse(job.to_string().as_bytes()).ok()?;
    let at_frame = job.at(FRAME).ok()?;
    let run =
        TileRequest { job: &job, frame: FRAME, rect: Rect::full(job.image.film().width, job.image.film().height) };
    let pixels = renderer.render(&run, &CancelFlag::new(), &|_| ()).unwrap();
    let bits = pixels.planes.iter().flatten().map(|value| value.to_bits()).collect();
    let mut file = Cursor::new(Vec::new());
    PictureSpec::new(&at_frame).write(&mut TileRows(&[pixels]), &mut file, &CancelFlag::new()).unwrap();
    Some(Shot {
        pixels: (job.image.film().channels(), bits),
        bytes: file.into_inner(),
        key: job.cache_key(FRAME).to_hex().to_string(),
        pixels_key: at_frame.pixels_cache_key().to_hex().to_string(),
        scene_hash: at_frame.scene_hash().to_hex().to_string(),
    })
}

/// Fields that change no byte of any picture. Every other field must be covered.
const WITHOUT_EFFECT: [&str; 6] = [
    "#/$defs/Group/properties/name",
    "#/properties/$schema",
    "#/properties/name",
    "#/properties/priority",
    "#/properties/priority/anyOf/0",
    "#/properties/priority/anyOf/1",
];

#[test]
fn a_field_changes_the_key_exactly_if_it_changes_bytes() {
    let schema = Schema::new(scene::schema());
    let jobs = corpus::jobs();
    let mut pools = BTreeMap::new();
    for job in &jobs {
        schema.walk(job, &mut |position| position.pool_into(&mut pools));
    }
    let (covered, next) = (Mutex::new(BTreeSet::new()), AtomicUsize::new(0));
    let check_jobs = || {
        let renderer = CpuRenderer::new(Some(1), Simd::Auto).unwrap();
        while let Some(job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
            let before = shot(&renderer, job)
                .unwrap_or_else(|| panic!("{:?}: {job}", scene::parse(job.to_string().as_bytes()).err()));
            schema.walk(job, &mut |position| change(&schema, &renderer, job, &before, position, &pools, &covered));
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(check_jobs);
        }
    });
    let (points, covered) = (schema.points(), covered.into_inner().unwrap());
    let uncovered: Vec<&String> = points.difference(&covered).collect();
    assert_eq!(uncovered, WITHOUT_EFFECT, "uncovered: add each to a job of corpus.rs whose pixels it changes");
}

/// Changes one value of a job in every way that is not covered yet.
fn change(
    schema: &Schema,
    renderer: &CpuRenderer,
    job: &Value,
    before: &Shot,
    position: &Position<'_>,
    pools: &BTreeMap<String, Vec<Value>>,
    covered: &Mutex<BTreeSet<String>>,
) {
    for (points, value) in schema.candidates(position, pools) {
        let points: Vec<&String> = points.iter().chain(&position.path).collect();
        if points.iter().all(|point| covered.lock().unwrap().contains(*point)) || value == *position.value {
            continue;
        }
        let mut changed = job.clone();
        *changed.pointer_mut(&position.pointer).unwrap() = value.clone();
        let Some(after) = shot(renderer, &changed) else { continue };
        let place = format!("{} from {} to {value} in {job}", position.pointer, position.value);
        // A slightly different goal changes no block's number of samples, in most pictures.
        let may_agree = position.pointer.starts_with("/image/samples/adaptive") && before.bytes == after.bytes;
        assert!(
            may_agree || (before.bytes != after.bytes) == (before.key != after.key),
            "cache keys and bytes: {place}"
        );
        if before.pixels != after.pixels {
            assert_ne!(before.pixels_key, after.pixels_key, "pixels differ: {place}");
            let in_scene = position.pointer.starts_with("/scene") && before.scene_hash == after.scene_hash;
            assert!(!in_scene, "provenance does not differ: {place}");
        }
        // A scene's hash is in its picture, so only the pixels show whether a field is used. An EXR has names, too.
        let is_name = position.pointer.ends_with("/name");
        let has_effect = before.pixels != after.pixels || position.pointer.starts_with("/image") || is_name;
        if has_effect && before.bytes != after.bytes {
            covered.lock().unwrap().extend(points.into_iter().cloned());
        }
    }
}

#[test]
fn fields_without_effect_on_bytes_change_no_key() {
    let renderer = CpuRenderer::new(Some(1), Simd::Auto).unwrap();
    for (job, pointer, value) in [
        (corpus::plain(), "/name", json!("another")),
        (corpus::plain(), "/priority", json!(7)),
        (corpus::plain(), "/frames/count", json!(9)),
        (corpus::png(), "/frames/fps", json!(30)),
        (corpus::plain(), "/scene/materials/unused", json!({ "flat": { "color": [0.5, 0, 0] } })),
        (corpus::plain(), "/image/bits", json!(16)),
        (corpus::png(), "/image/precision", json!("half")),
    ] {
        let mut changed = job.clone();
        *changed.pointer_mut(pointer).unwrap_or_else(|| panic!("{pointer}")) = value;
        let [before, after] = [&job, &changed].map(|job| shot(&renderer, job).unwrap());
        assert!(before.bytes == after.bytes && before.key == after.key, "{pointer}");
    }
    let mut renamed = corpus::plain();
    let used = renamed["scene"]["materials"]["used"].take();
    renamed["scene"]["materials"] = json!({ "red": used });
    renamed["scene"]["objects"][0]["material"] = json!("red");
    let [before, after] = [&corpus::plain(), &renamed].map(|job| shot(&renderer, job).unwrap());
    assert!(before.bytes == after.bytes && before.key == after.key);
}

/// Kernels are cached by the hash of their source, architecture and compiler: only the source depends on the
/// scene.
#[test]
fn different_pictures_have_different_kernels_or_uniforms() {
    let source =
        |job: &Value| KernelSource::new(&scene::parse(job.to_string().as_bytes()).unwrap().at(FRAME).unwrap()).unwrap();
    let jobs = corpus::jobs();
    let mut seen = BTreeMap::new();
    let renderer = CpuRenderer::new(Some(1), Simd::Auto).unwrap();
    for job in &jobs {
        let program = source(job);
        let numbers = program.parameters;
        let pixels = shot(&renderer, job).unwrap().pixels.1;
        if let Some((other, others)) = seen.insert((program.text, numbers), (job, pixels.clone())) {
            assert_eq!(pixels, others, "one kernel with the same uniforms, and two pictures: {job} and {other}");
        }
    }
}
