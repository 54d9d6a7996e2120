//! From the text of a job file to a [`Job`], or to what is wrong with it.

mod lists;
mod wording;

use std::fmt::Write as _;

use serde::de::IgnoredAny;
use serde_path_to_error::{Path, Segment};

use crate::fault::{Fault, Refusal};
use crate::job::{Format, Frames, Job, ToneMap};
use crate::limits::{
    MAX_JSON_DEPTH, MAX_LIGHTS, MAX_MATERIALS, MAX_NAME_CHARS, MAX_NODE_DEPTH, MAX_NODES, MAX_PIXELS, MAX_RAYS,
};
use crate::motion::{Motion, frames_to_check};
use crate::nodes::{Node, NodeFault};
use crate::outline::{self, OutlineFaultKind};
use crate::scene::child_steps;
use crate::values::track::Reading;

/// No answer lists more faults than this.
const MAX_FAULTS: usize = 100;

/// Reads a job: strictly, and with the place of every fault.
pub fn parse(text: &[u8]) -> Result<Job, Refusal> {
    let text = std::str::from_utf8(text).map_err(|error| not_utf8(text, error.valid_up_to()))?;
    let outline = outline::check(text, MAX_JSON_DEPTH);
    if let Err(fault) = &outline
        && fault.kind == OutlineFaultKind::TooDeep
    {
        let message =
            format!("nests deeper than {MAX_JSON_DEPTH} arrays and objects: nest nodes at most {MAX_NODE_DEPTH} deep");
        return Err(Refusal::Wrong(vec![Fault::at(text, Some(fault.offset), fault.pointer.clone(), message)]));
    }
    if text.starts_with('\u{feff}') {
        let message = "begins with a byte order mark: save the file as UTF-8 without one";
        return Err(Refusal::NotJson(Fault::at(text, Some(0), String::new(), message)));
    }
    serde_json::from_str::<IgnoredAny>(text).map_err(|error| Refusal::NotJson(broken(&error)))?;
    if let Err(fault) = outline
        && let OutlineFaultKind::DoubledKey(key) = fault.kind
    {
        let message = format!("the key \"{key}\" stands here twice: keep one");
        return Err(Refusal::Wrong(vec![Fault::at(text, Some(fault.offset), fault.pointer, message)]));
    }
    let Read { mut job, moves, key_seconds } = read(text, 0, None)?;
    if moves {
        for frame in frames_to_check(&job.frames, &key_seconds, text.len()) {
            at(text, frame, &job.frames)?;
        }
        job.motion = Some(Motion::of(text));
    }
    Ok(job)
}

/// Reads the text of a job that moves as it stands in a frame.
pub(crate) fn at(text: &str, frame: u32, frames: &Frames) -> Result<Job, Refusal> {
    read(text, frame, Some(frames)).map(|read| read.job)
}

/// A job as it stands in a frame.
struct Read {
    job: Job,
    /// Whether frames differ in more than their sampling noise.
    moves: bool,
    /// The times of all keys.
    key_seconds: Vec<f64>,
}

/// Reads a sound text's job as it stands in a frame, which needs its `frames` unless it is the first.
fn read(text: &str, frame: u32, frames: Option<&Frames>) -> Result<Read, Refusal> {
    let seconds = frames.map_or(0.0, |frames| frames.seconds(frame));
    let in_frame = |mut fault: Fault| {
        if frame > 0 {
            let _ = write!(fault.message, " (in frame {frame}, at {seconds} seconds)");
        }
        fault
    };
    let reading = Reading::at(seconds);
    let mut job = form(text).map_err(|fault| Refusal::Wrong(vec![in_frame(fault)]))?;
    let key_seconds = reading.end();
    if frames.is_none()
        && let Some(pointer) = lists::in_place_of_object(text, &job)
    {
        let message = "must be an object, not a list: write each value behind its key";
        return Err(Refusal::Wrong(vec![Fault::of_value(text, pointer, message)]));
    }
    let turns = job.scene.camera.turn(frame, &job.frames);
    let moves = turns || !key_seconds.is_empty();
    let faults = meaning(&mut job, moves);
    if faults.is_empty() {
        return Ok(Read { job, moves, key_seconds });
    }
    let place = |(pointer, message)| in_frame(Fault::of_value(text, pointer, message));
    Err(Refusal::Wrong(faults.into_iter().take(MAX_FAULTS).map(place).collect()))
}

fn not_utf8(text: &[u8], offset: usize) -> Refusal {
    let valid = String::from_utf8_lossy(&text[..offset]);
    let message = "is not UTF-8: save the file as UTF-8 text";
    Refusal::NotJson(Fault::at(&valid, Some(valid.len()), String::new(), message))
}

fn broken(error: &serde_json::Error) -> Fault {
    Fault {
        pointer: String::new(),
        message: without_place(&error.to_string()),
        line: error.line() as u32,
        column: error.column().max(1) as u32,
    }
}

fn without_place(message: &str) -> String {
    message.rsplit_once(" at line ").map_or(message, |(message, _)| message).to_owned()
}

/// Reads the text's form; its first fault otherwise.
fn form(text: &str) -> Result<Job, Fault> {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    deserializer.disable_recursion_limit();
    serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let message = without_place(&error.inner().to_string());
        let pointer = pointer(error.path());
        if let Some(name) = unknown_choice(&message) {
            let key = format!("{pointer}/{}", outline::escape(name));
            if outline::locate_key(text, &key).is_some() {
                return Fault::of_key(text, key, message);
            }
            if last(&pointer) == outline::escape(name) && outline::locate_key(text, &pointer).is_some() {
                return Fault::of_key(text, pointer, message);
            }
            // Where the path ends in the choice itself, the text has no such place.
            let place = if outline::locate_value(text, &pointer).is_some() { &pointer } else { parent(&pointer) };
            return Fault::of_value(text, place.to_owned(), message);
        }
        if message.starts_with("unknown ") && outline::locate_key(text, &pointer).is_some() {
            return Fault::of_key(text, pointer, message);
        }
        let (pointer, message) = wording::reworded(text, pointer, message);
        Fault::of_value(text, pointer, message)
    })
}

/// The name in serde's words about a choice that there is not.
fn unknown_choice(message: &str) -> Option<&str> {
    message.strip_prefix("unknown variant `")?.split_once('`').map(|(name, _)| name)
}

fn parent(pointer: &str) -> &str {
    pointer.rsplit_once('/').map_or("", |(parent, _)| parent)
}

fn last(pointer: &str) -> &str {
    pointer.rsplit_once('/').map_or("", |(_, last)| last)
}

fn pointer(path: &Path) -> String {
    path.iter().fold(String::new(), |mut pointer, segment| {
        match segment {
            Segment::Seq { index } => write!(pointer, "/{index}"),
            Segment::Map { key } | Segment::Enum { variant: key } => write!(pointer, "/{}", outline::escape(key)),
            Segment::Unknown => Ok(()),
        }
        .expect("a String takes all that is written");
        pointer
    })
}

/// Pointer and message of every fault of meaning.
type Faults = Vec<(String, String)>;

/// Looks at what the parts mean together, and makes the scene ready to be rendered.
fn meaning(job: &mut Job, moves: bool) -> Faults {
    let mut faults = Faults::new();
    let mut fault = |pointer: &str, message: String| faults.push((pointer.to_owned(), message));
    if job.name.chars().count() > MAX_NAME_CHARS {
        fault("/name", format!("is longer than {MAX_NAME_CHARS} characters"));
    }
    if let Some((key, message)) = job.scene.camera.fault() {
        fault(&format!("/scene/camera/{key}"), message.to_owned());
    }
    job.scene.camera.complete();
    if job.scene.lights.len() > MAX_LIGHTS {
        fault("/scene/lights", format!("has {} lights: use at most {MAX_LIGHTS}", job.scene.lights.len()));
    }
    if job.scene.objects.is_empty() {
        fault("/scene/objects", "is empty: a scene needs an object or more".to_owned());
    }
    let (mut nodes, mut is_sound) = (0, true);
    for (index, object) in job.scene.objects.iter().enumerate() {
        is_sound &= tree(&object.shape, &mut format!("/scene/objects/{index}/shape"), 1, &mut nodes, &mut fault);
    }
    if nodes > MAX_NODES {
        fault("/scene/objects", format!("has {nodes} nodes: use at most {MAX_NODES}"));
    }
    image(job, &mut fault);
    if is_sound {
        job.scene.prepare(moves);
    }
    for (pointer, name) in job.scene.resolve_materials() {
        let known: Vec<&str> = job.scene.materials.keys().map(String::as_str).collect();
        let cure = if known.is_empty() {
            "define it there, or write a material in place".to_owned()
        } else {
            format!("choose one of {}", known.join(", "))
        };
        faults.push((format!("/scene{pointer}"), format!("\"{name}\" is not in /scene/materials: {cure}")));
    }
    faults.extend(job.scene.faults().into_iter().map(|(pointer, message)| (format!("/scene{pointer}"), message)));
    if job.scene.slots().len() > MAX_MATERIALS {
        let used = job.scene.slots().len();
        let message = format!("uses {used} materials: use at most {MAX_MATERIALS}; materials with a name count once");
        faults.push(("/scene/objects".to_owned(), message));
    }
    faults
}

/// Looks at a node and at all in it; says whether they are sound, so that they may be asked for their
/// bounds. What is wrong inside a node is told first: only of sound shapes can it say what is wrong with them.
fn tree(
    node: &Node,
    pointer: &mut String,
    depth: usize,
    nodes: &mut usize,
    fault: &mut impl FnMut(&str, String),
) -> bool {
    *nodes += 1;
    if depth == MAX_NODE_DEPTH + 1 {
        fault(pointer, format!("nests {depth} nodes deep: nest at most {MAX_NODE_DEPTH}"));
    }
    let mut is_sound = true;
    let length = pointer.len();
    for (child, step) in node.children().iter().zip(child_steps(node)) {
        pointer.push_str(&step);
        is_sound &= tree(child, pointer, depth + 1, nodes, fault);
        pointer.truncate(length);
    }
    let name = node.name();
    if node.has_list() && node.children().is_empty() {
        fault(&format!("{pointer}/{name}/of"), format!("is empty: {name} needs a shape or more"));
        return false;
    }
    match is_sound.then(|| node.fault()).flatten() {
        Some(NodeFault { place, message }) => {
            fault(&format!("{pointer}/{name}/{place}"), message);
            false
        }
        None => is_sound,
    }
}

fn image(job: &Job, fault: &mut impl FnMut(&str, String)) {
    let image = &job.image;
    if image.pixels() > MAX_PIXELS {
        let pixels = image.pixels();
        fault("/image", format!("has {pixels} pixels: a frame may have {MAX_PIXELS}; make width or height less"));
    }
    let rays = u128::from(job.rays_per_frame()) * u128::from(job.frames.count);
    if rays > u128::from(MAX_RAYS) {
        fault(
            "/image",
            format!("asks for {rays} rays: a job may have {MAX_RAYS}; use fewer pixels, samples or frames"),
        );
    }
    if image.format == Format::Png && !image.layers.is_empty() {
        fault("/image/layers", "a PNG has no layers: set format to \"exr\", or leave layers out".to_owned());
    }
    if image.format == Format::Exr && image.is_graded() {
        let key = if image.tone_map == ToneMap::None { "exposure" } else { "tone_map" };
        fault(&format!("/image/{key}"), format!("an EXR stays linear: leave {key} out, or set format to \"png\""));
    }
    for (index, layer) in image.layers.iter().enumerate() {
        if image.layers[..index].contains(layer) {
            fault(&format!("/image/layers/{index}"), "stands here twice: keep one".to_owned());
        }
    }
}
