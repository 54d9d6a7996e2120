//! Warnings about a job that is valid but probably does not render as intended.
//!
//! Every check is fast for any job: it samples a limited number of rays, and at most three frames.

mod clear;
mod empty;
mod fallen;
mod numbers;
mod own_space;
mod samples;
mod scene;
mod view;

use picture::animation::JobAtFrame;
use picture::film::Layer;
use picture::job::Job;
use picture::scene::Scene;

/// Subject of a warning: a job gets at most one warning of each kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum WarningKind {
    /// The camera is inside an object.
    CameraInside,
    /// Nothing is in view.
    NothingInView,
    /// Rays run out of steps.
    OutOfSteps,
    /// A shape makes steps small.
    HighLipschitz,
    /// One evaluation of the scene takes long.
    HighCost,
    /// Lights without effect, or materials without light.
    Lighting,
    /// A light is inside an opaque object.
    EnclosedLight,
    /// A medium is too dense for its steps.
    DenseMedium,
    /// Rays end inside glass because of the bounce limit.
    TooFewBounces,
    /// Colors have a range of 0 to 255.
    Colors,
    /// Angles are in radians.
    Radians,
    /// A texture does not follow its animated object.
    Swims,
    /// A difference is empty.
    Empty,
    /// Scattered copies missed what they should be on.
    Fallen,
    /// Transparent surfaces coincide.
    Touching,
    /// Metal has nothing to reflect.
    Mirrors,
    /// More samples than make a visible difference.
    Samples,
}

/// Warning about one frame.
#[derive(Debug)]
struct Warning {
    kind: WarningKind,
    text: String,
}

/// Warnings: suspicious properties of a valid job. Samples some rays of it, which takes milliseconds.
pub fn of(job: &Job) -> Vec<String> {
    let mut warnings = job_warnings(job);
    let last = job.frames.count - 1;
    let mut frames = if job.is_animated() { vec![0, last / 2, last] } else { vec![0] };
    frames.dedup();
    let mut reported: Vec<(u32, Warning)> = Vec::new();
    let mut without_view = 0;
    for &frame in &frames {
        let Ok(at_frame) = job.at(frame) else { continue };
        for warning in frame_warnings(&at_frame) {
            without_view += usize::from(warning.kind == WarningKind::NothingInView);
            if reported.iter().all(|(_, known)| known.kind != warning.kind) {
                reported.push((frame, warning));
            }
        }
    }
    // Objects may come into view, or leave it.
    reported.retain(|(_, warning)| warning.kind != WarningKind::NothingInView || without_view == frames.len());
    warnings.extend(reported.into_iter().map(|(frame, Warning { kind, text })| {
        let is_of_all = kind == WarningKind::NothingInView || !job.is_animated();
        if is_of_all { text } else { format!("{text} (in frame {frame})") }
    }));
    warnings.into_iter().map(|text| with_object_names(&job.scene, &text)).collect()
}

/// A warning with the names of the objects that it mentions by their JSON pointers.
fn with_object_names(scene: &Scene, text: &str) -> String {
    const OBJECT: &str = "/scene/objects/";
    let mut named = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(start) = rest.find(OBJECT) {
        let digits = rest[start + OBJECT.len()..].bytes().take_while(u8::is_ascii_digit).count();
        let (before, after) = rest.split_at(start + OBJECT.len() + digits);
        let index = before[start + OBJECT.len()..].parse::<usize>().ok();
        let pointer_end =
            after.bytes().take_while(|&byte| byte == b'/' || byte == b'_' || byte.is_ascii_alphanumeric()).count();
        let (pointer, after) = after.split_at(pointer_end);
        named.push_str(before);
        named.push_str(pointer);
        if let Some(name) = index.and_then(|index| scene.objects.get(index)?.name.as_deref()) {
            named.extend([" (\"", name, "\")"]);
        }
        rest = after;
    }
    named.push_str(rest);
    named
}

fn job_warnings(job: &Job) -> Vec<String> {
    let mut warnings = Vec::new();
    if job.frames.count > 1 && !job.is_animated() {
        warnings.push(format!(
            "nothing in the scene is animated: the {} frames differ only in their sampling noise",
            job.frames.count
        ));
    }
    if job.frames.count == 1 && job.is_animated() && !job.is_blurred() && !job.shows_motion() {
        warnings.push("the scene is animated, but the job has one frame: set frames.count to render more".to_owned());
    }
    if job.image.layers.contains(&Layer::Motion) && !job.is_animated() {
        warnings.push(
            "the layer motion is 0 everywhere, because nothing in the scene is animated: animate the camera or an object, or leave it out of image.layers"
                .to_owned(),
        );
    }
    warnings.extend(job.scene.camera.projection.warning(job.image.film()));
    warnings.extend(samples::too_few(job));
    warnings.extend(scene::lost_ambient(job));
    for name in &job.unused_materials {
        warnings.push(format!("material \"{name}\" is not used"));
    }
    for name in &job.unused_shapes {
        warnings.push(format!("shape \"{name}\" is not used"));
    }
    warnings
}

fn frame_warnings(at_frame: &JobAtFrame<'_>) -> Vec<Warning> {
    let scene = at_frame.scene();
    let seen = view::of(at_frame);
    let known = [
        (WarningKind::HighCost, scene::high_cost(scene)),
        (WarningKind::HighLipschitz, scene::high_lipschitz(at_frame)),
        (WarningKind::Lighting, scene::light(scene)),
        (WarningKind::EnclosedLight, scene::enclosed_lights(scene)),
        (WarningKind::DenseMedium, scene::dense_media(scene)),
        (WarningKind::TooFewBounces, scene::bounces(scene)),
        (WarningKind::Colors, numbers::colors_of_255(scene)),
        (WarningKind::Radians, numbers::radians(at_frame)),
        (WarningKind::Swims, own_space::swims(at_frame)),
        (WarningKind::Empty, empty::difference(at_frame)),
        (WarningKind::Fallen, fallen::copies(at_frame)),
        (WarningKind::Touching, clear::touching(scene)),
        (WarningKind::Mirrors, clear::nothing_to_mirror(scene)),
        (WarningKind::Samples, samples::too_many(scene, at_frame.image())),
    ];
    let known = known.into_iter().filter_map(|(kind, text)| Some(Warning { kind, text: text? }));
    seen.into_iter().chain(known).collect()
}

/// Names some objects: "object 3", or "object 3 (\"leg\"), 5 and 7 others".
fn objects(scene: &Scene, indices: &[usize]) -> String {
    let one = |index: &usize| match scene.objects.get(*index).and_then(|object| object.name.as_deref()) {
        Some(name) => format!("{index} (\"{name}\")"),
        None => index.to_string(),
    };
    match indices {
        [only] => format!("object {}", one(only)),
        [first, second] => format!("objects {} and {}", one(first), one(second)),
        [first, second, third] => format!("objects {}, {} and {}", one(first), one(second), one(third)),
        [first, second, rest @ ..] => format!("objects {}, {} and {} others", one(first), one(second), rest.len()),
        [] => String::new(),
    }
}
