//! Parses the text of a job file into a [`Job`], or reports every error in it.

mod collect;
mod comments;
mod count;
mod depends;
mod expand;
mod form;
mod groups;
mod light_groups;
mod messages;
mod names;
mod nodes;
mod placed;
mod set;
mod stand_ins;
mod suggest;
mod syntax;
#[cfg(test)]
mod tests;
mod tree;

pub use self::comments::plain_json;
pub use self::count::Expansion;
pub use self::set::set_value;

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::animation::{FrameError, frames_to_check};
use crate::document::{JobDocument, NamedShapes, Resolved};
use crate::error::{Fault, LineIndex, ParseError, ValidationError};
use crate::film::{Format, Layer, ToneMap};
use crate::job::Job;
use crate::json::{Outline, OutlineError, OutlineErrorKind, SyntaxError, Tree};
use crate::lights::PlacedLight;
use crate::limits::{
    MAX_JSON_DEPTH, MAX_KEY_BYTES, MAX_LIGHTS, MAX_MATERIALS, MAX_NAME_CHARS, MAX_NODE_DEPTH, MAX_PIXELS, MAX_RAYS,
    MAX_VALUES, MIN_REWEIGHTED_SAMPLES,
};
use crate::sample_count::AdaptiveSamples;
use crate::seek::{FrameTime, Seek};
use crate::transport::{PathSettings, Transport};
use crate::written::GroupPointers;

/// Maximum number of errors in one response.
const MAX_ERRORS: usize = 100;

/// Parses a job strictly, and reports the position of every error. Comments and trailing commas are ignored.
pub fn parse(text: &[u8]) -> Result<Job, ParseError> {
    let tree = tree(text)?;
    job(&tree).map_err(|errors| ParseError::Invalid(names::add_object_names(&tree, errors)))
}

/// Counts what a job becomes when its formulas are replaced, without making it. The job need not be valid.
///
/// # Errors
/// Fails at the position where the text is not JSON, nests too deep, or is not UTF-8.
pub fn expansion(text: &[u8]) -> Result<Expansion, ParseError> {
    formattable(text).map(|tree| count::count(&tree))
}

/// Whether a JSON pointer leads to a value of a text.
pub fn has_value(text: &str, pointer: &str) -> bool {
    Tree::read(text).is_ok_and(|tree| tree.value_at(pointer).is_some())
}

/// The job of a tree, or its errors at their positions.
fn job(tree: &Tree<'_>) -> Result<Job, Vec<ValidationError>> {
    let error = tree.outline().error();
    let refusal = error.map(of_outline);
    let is_too_deep = match error.map(|error| &error.kind) {
        Some(OutlineErrorKind::LongMember(_)) => {
            return Err(Fault::placed(tree.text(), refusal.into_iter().collect()));
        }
        Some(OutlineErrorKind::TooDeep) => true,
        Some(OutlineErrorKind::DuplicateMember(_)) | None => false,
    };
    let Some(expanded) = (!is_too_deep && tree.has_formulas()).then(|| expand::expand(tree)) else {
        return plain(tree, refusal, &|_, _| true).map_err(|faults| Fault::placed(tree.text(), faults));
    };
    if expanded.is_too_large {
        return Err(expanded.place(tree, Vec::new()));
    }
    let wrong = expanded.wrong(tree);
    let is_sure = |pointer: &str, at| expanded.is_sure(tree, &wrong, pointer, at);
    let faults = match plain(&expanded.tree, refusal, &is_sure) {
        Ok(mut job) if expanded.is_sound() => {
            if let Some(written) = job.written.as_mut().and_then(Arc::get_mut) {
                written.instances = expanded.instances;
            }
            return Ok(job);
        }
        Ok(_) => Vec::new(),
        Err(faults) => faults,
    };
    Err(expanded.place(tree, faults))
}

/// Reads a text, which must be JSON with comments and trailing commas.
fn tree(text: &[u8]) -> Result<Tree<'_>, ParseError> {
    let text = utf8(text)?;
    if text.starts_with('\u{feff}') {
        let message = "begins with a byte order mark: save the file as UTF-8 without one";
        return Err(ParseError::NotJson(LineIndex::new(text).fault(0, String::new(), message.to_owned())));
    }
    Tree::read(text).map_err(|SyntaxError { outline }| {
        // The nesting depth and long keys are reported before any syntax error.
        refused(text, &outline).unwrap_or_else(|| ParseError::NotJson(syntax::explain(text)))
    })
}

/// Reads a text, which must be JSON with comments and trailing commas and nest no deeper than a job may.
pub(crate) fn formattable(text: &[u8]) -> Result<Tree<'_>, ParseError> {
    let tree = tree(text)?;
    refused(tree.text(), tree.outline()).map_or(Ok(tree), Err)
}

/// The error of a text that nests too deep or has a long key.
fn refused(text: &str, outline: &Outline) -> Option<ParseError> {
    let error = outline.error().filter(|error| !matches!(error.kind, OutlineErrorKind::DuplicateMember(_)))?;
    Some(ParseError::Invalid(Fault::placed(text, vec![of_outline(error)])))
}

/// Parses a tree without formulas, which may have an error of its outline. `is_sure` tells of an error of its meaning,
/// by pointer and byte offset, whether it is certain.
fn plain(tree: &Tree<'_>, refusal: Option<Fault>, is_sure: &dyn Fn(&str, usize) -> bool) -> Result<Job, Vec<Fault>> {
    let first = match refusal {
        None => match sound(tree) {
            Ok(job) => return Ok(job),
            Err(first) => first,
        },
        Some(refusal) => vec![refusal],
    };
    let meaning = |tree: &Tree<'_>| match sound(tree) {
        Ok(_) => Vec::new(),
        Err(faults) => faults.into_iter().map(|fault| (fault.pointer, fault.message)).collect(),
    };
    let all = collect::all(tree, meaning, is_sure);
    Err(if all.is_empty() { first } else { all })
}

/// Error of the outline of a text.
fn of_outline(error: &OutlineError) -> Fault {
    let message = match &error.kind {
        OutlineErrorKind::TooDeep => too_deep(),
        OutlineErrorKind::LongMember(bytes) => format!("has a key of {bytes} bytes: use at most {MAX_KEY_BYTES}"),
        OutlineErrorKind::DuplicateMember(key) => twice(key),
    };
    Fault { pointer: error.pointer.clone(), message, at: Some(error.at) }
}

/// Parses a tree without errors of its outline: returns a job, or the first error of its form, or every error of its
/// meaning.
fn sound(tree: &Tree<'_>) -> Result<Job, Vec<Fault>> {
    let (job, key_seconds) = read(tree)?;
    if job.is_animated {
        let first = (job.is_blurred() || job.shows_motion()).then_some(0);
        let others = frames_to_check(&job.frames, &key_seconds, tree.length() * job.instants() as usize);
        for frame in first.into_iter().chain(others) {
            job.exposure(frame).map_err(|error| vec![in_later_frame(tree, error)])?;
        }
    }
    Ok(job)
}

/// Error of a frame at which a job of this text cannot be evaluated.
pub fn error_in_frame(text: &[u8], error: FrameError) -> ParseError {
    match tree(text) {
        Ok(tree) => ParseError::Invalid(Fault::placed(tree.text(), vec![in_later_frame(&tree, error)])),
        Err(error) => error,
    }
}

fn in_later_frame(tree: &Tree<'_>, error: FrameError) -> Fault {
    let FrameError { pointer, message, frame, seconds } = error;
    Fault::at_value(tree, pointer, format!("{message} (in frame {frame}, at {seconds} seconds)"))
}

fn twice(key: &str) -> String {
    format!("duplicate key \"{key}\": remove one")
}

fn too_deep() -> String {
    format!("nests deeper than {MAX_JSON_DEPTH} arrays and objects: nest nodes at most {MAX_NODE_DEPTH} deep")
}

/// Parses a tree into a job, with the times of all keyframes.
fn read(tree: &Tree<'_>) -> Result<(Job, Vec<f64>), Vec<Fault>> {
    let document: JobDocument = form::read(tree).map_err(|fault| vec![fault.placed(tree)])?;
    validate(document, tree).map_err(|mut faults| {
        faults.truncate(MAX_ERRORS);
        faults.into_iter().map(|(pointer, message)| Fault::at_value(tree, pointer, message)).collect()
    })
}

fn utf8(text: &[u8]) -> Result<&str, ParseError> {
    std::str::from_utf8(text).map_err(|error| not_utf8(text, error.valid_up_to()))
}

fn not_utf8(text: &[u8], offset: usize) -> ParseError {
    let valid = String::from_utf8_lossy(&text[..offset]);
    let message = "is not UTF-8: save the file as UTF-8 text";
    ParseError::NotJson(LineIndex::new(&valid).fault(valid.len(), String::new(), message.to_owned()))
}

/// Pointer and message of every semantic error.
type SemanticErrors = Vec<(String, String)>;

/// Validates the parts of a document of a tree together, and creates a job that is ready to be rendered, with the times
/// of all keyframes.
fn validate(mut document: JobDocument, tree: &Tree<'_>) -> Result<(Job, Vec<f64>), SemanticErrors> {
    document.scene.camera.link();
    let mut faults = faults_of_document(&document);
    let values = placed::groups(tree);
    if values > MAX_VALUES {
        let message = format!(
            "have motion of {values} values, counting it for each object in them: use at most {MAX_VALUES}, with fewer keys"
        );
        faults.push(("/scene/groups".to_owned(), message));
        return Err(faults);
    }
    let (lights, groups) = groups::flatten(&mut document.scene, &mut faults);
    if let Some(message) = document.image.region_error() {
        faults.push(("/image/region".to_owned(), message));
    }
    let result = validate_flat(document, tree, lights, &groups, faults);
    result.map_err(|mut faults| {
        let mut seen = BTreeSet::new();
        for (pointer, _) in &mut faults {
            if let Some(in_scene) = pointer.strip_prefix("/scene") {
                *pointer = format!("/scene{}", groups.written(in_scene));
            }
        }
        // An error of a group is one of each object in it.
        faults.retain(|fault| seen.insert(fault.clone()));
        faults
    })
}

/// Validates a document whose groups have been replaced.
fn validate_flat(
    document: JobDocument,
    tree: &Tree<'_>,
    lights: Vec<PlacedLight>,
    groups: &GroupPointers,
    mut faults: SemanticErrors,
) -> Result<(Job, Vec<f64>), SemanticErrors> {
    let JobDocument { schema: _, name, mut scene, mut image, frames, priority } = document;
    if let Transport::Path(PathSettings { straight_shadows: true, max_bounces: _ }) = scene.integrator
        && scene.objects.iter().any(|object| !object.visible.is_full())
    {
        let message = "does not go with objects that some rays do not see: leave it out, or `visible` of the objects";
        faults.push(("/scene/integrator/path/straight_shadows".to_owned(), message.to_owned()));
    }
    let mut shapes = nodes::expand(&mut scene, tree, groups, &mut faults);
    let names: Vec<String> = scene.materials.keys().cloned().collect();
    let resolved = scene.resolve(lights, &mut shapes);
    let Resolved { mut scene, material_count, material_pointers: places, unused_names: unused, unknown } = resolved;
    let NamedShapes { written, unused_names: unused_shapes, unused: _ } = shapes;
    let in_document = |pointer: String| written.as_ref().map_or(pointer.clone(), |written| written.pointer(&pointer));
    for (pointer, name) in unknown.into_iter().take(MAX_ERRORS) {
        let known: Vec<&str> = names.iter().map(String::as_str).collect();
        faults.push((format!("/scene{pointer}"), suggest::unknown_material(&name, &known)));
    }
    let in_scene = scene.validation_errors().into_iter();
    let in_scene: BTreeSet<_> = in_scene.map(|(pointer, message)| (in_document(pointer), message)).collect();
    faults.extend(in_scene.into_iter().map(|(pointer, message)| (format!("/scene{pointer}"), message)));
    faults.extend(light_groups::errors(&image, &scene));
    if material_count > MAX_MATERIALS {
        let message =
            format!("uses {material_count} materials: use at most {MAX_MATERIALS}; materials with a name count once");
        faults.push(("/scene/objects".to_owned(), message));
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    let mut key_seconds = Vec::new();
    let clock = &mut FrameTime::recording(&mut key_seconds);
    let sought = scene.seek(clock).and_then(|in_scene| Ok(in_scene | image.seek(clock)?));
    let is_animated =
        sought.map_err(|misfit| vec![(format!("/scene{}", in_document(misfit.pointer)), misfit.message)])?;
    let is_animated = is_animated || scene.camera.turntable.is_some();
    scene.prepare(is_animated);
    let job = Job {
        name,
        scene,
        image,
        frames,
        priority,
        is_animated,
        material_pointers: places,
        unused_materials: unused,
        unused_shapes,
        written: written.map(Arc::new),
    };
    Ok((job, key_seconds))
}

/// Errors in a document that do not depend on its materials and nodes.
fn faults_of_document(document: &JobDocument) -> SemanticErrors {
    let mut faults = SemanticErrors::new();
    let mut fault = |pointer: &str, message: String| faults.push((pointer.to_owned(), message));
    let JobDocument { schema: _, name, scene, image: _, frames: _, priority: _ } = document;
    if name.chars().count() > MAX_NAME_CHARS {
        fault("/name", format!("is longer than {MAX_NAME_CHARS} characters"));
    }
    if name.contains('\0') {
        fault("/name", "has the character \\u0000, which cannot be stored: leave it out".to_owned());
    }
    for (key, message) in scene.camera.errors() {
        fault(&format!("/scene/camera/{key}"), message.to_owned());
    }
    let light_count = scene.lights.len() + groups::light_count(&scene.groups);
    if light_count > MAX_LIGHTS {
        fault("/scene/lights", format!("has {light_count} lights: use at most {MAX_LIGHTS}"));
    }
    if scene.objects.is_empty() {
        fault("/scene/objects", "is empty: a scene needs an object or more".to_owned());
    }
    for (index, object) in scene.objects.iter().enumerate() {
        if let Some(message) = object.name.as_deref().and_then(names::object_name_error) {
            fault(&format!("/scene/objects/{index}/name"), message);
        }
    }
    image(document, &mut fault);
    faults
}

fn image(document: &JobDocument, fault: &mut impl FnMut(&str, String)) {
    let image = &document.image;
    let pixels = u64::from(image.width) * u64::from(image.height);
    if pixels > MAX_PIXELS {
        fault(
            "/image",
            format!("has {pixels} pixels: a frame may have at most {MAX_PIXELS}; make width or height smaller"),
        );
    }
    let rays = u128::from(pixels * u64::from(image.samples.max())) * u128::from(document.frames.count);
    if rays > u128::from(MAX_RAYS) {
        fault(
            "/image",
            format!("has {rays} rays: a job may have at most {MAX_RAYS}; use fewer pixels, samples or frames"),
        );
    }
    if let Some((key, message)) = image.samples.adaptive().and_then(AdaptiveSamples::error_between) {
        fault(&format!("/image/samples/adaptive/{key}"), message);
    }
    if image.denoise && image.samples.max() < 2 {
        fault(
            "/image/denoise",
            "needs 2 samples or more, whose difference tells their noise: set samples to 16, or leave denoise out"
                .to_owned(),
        );
    }
    let noisy = image.layers.iter().position(|layer| *layer == Layer::Noisy);
    if let Some(index) = noisy.filter(|_| !image.denoise && !image.reweight_fireflies) {
        fault(
            &format!("/image/layers/{index}"),
            "has the colors before the denoiser: set denoise or reweight_fireflies to true, or leave this layer out"
                .to_owned(),
        );
    }
    if image.reweight_fireflies && image.samples.min() < MIN_REWEIGHTED_SAMPLES {
        let places = if image.samples.adaptive().is_some() { "samples.adaptive.min" } else { "samples" };
        fault(
            "/image/reweight_fireflies",
            format!(
                "needs {MIN_REWEIGHTED_SAMPLES} samples or more, among which fireflies are rare: set {places} to {MIN_REWEIGHTED_SAMPLES}, or leave it out"
            ),
        );
    }
    if image.reweight_fireflies && !document.scene.integrator.is_path() {
        fault(
            "/image/reweight_fireflies",
            "is of the integrator \"path\" only: set scene.integrator to { \"path\": {} }, or leave it out".to_owned(),
        );
    }
    let matte = image.layers.iter().position(|layer| layer.is_matte());
    if let Some(index) = matte.filter(|_| document.frames.shutter.get() > 0.0) {
        fault(
            &format!("/image/layers/{index}"),
            "does not know motion blur: set shutter to 0 and blur the picture by the layer motion, or leave this layer out".to_owned(),
        );
    }
    if image.format == Format::Png && !image.layers.is_empty() {
        fault("/image/layers", "a PNG has no layers: set format to \"exr\", or leave layers out".to_owned());
    }
    if image.format == Format::Exr && image.has_display_transform() {
        let key = if image.tone_map == ToneMap::None { "exposure" } else { "tone_map" };
        fault(&format!("/image/{key}"), format!("an EXR is linear: leave {key} out, or set format to \"png\""));
    }
    for (index, layer) in image.layers.iter().enumerate() {
        if image.layers[..index].contains(layer) {
            fault(&format!("/image/layers/{index}"), "is listed twice: remove one".to_owned());
        }
    }
}
