//! Errors in the light groups of a picture.

use std::collections::BTreeSet;

use super::SemanticErrors;
use crate::film::{Format, ImageSpec};
use crate::light_groups::LightGroup;
use crate::limits::{MAX_LIGHT_GROUP_RUNS, MAX_LIGHT_GROUPS};
use crate::scene::{LightGroups, Scene};

/// Pointer to the light groups that a picture lists.
const LISTED: &str = "/image/light_groups";

/// Errors in the light groups of a picture of a scene.
pub(super) fn errors(image: &ImageSpec, scene: &Scene) -> SemanticErrors {
    let mut faults = SemanticErrors::new();
    let Some(groups) = LightGroups::of(&image.light_groups, scene) else { return faults };
    let mut fault = |pointer: String, message: String| faults.push((pointer, message));
    let listed = &image.light_groups;
    if image.format == Format::Png {
        fault(LISTED.to_owned(), "a PNG has no layers: set format to \"exr\", or leave light_groups out".to_owned());
    }
    if !scene.integrator.is_path() {
        fault(
            LISTED.to_owned(),
            "are of the integrator \"path\" only: set scene.integrator to { \"path\": {} }, or leave light_groups out"
                .to_owned(),
        );
    }
    if listed.len() > MAX_LIGHT_GROUPS {
        fault(
            LISTED.to_owned(),
            format!(
                "has {} light groups: use at most {MAX_LIGHT_GROUPS}; light of the others is in light.rest",
                listed.len()
            ),
        );
    }
    let named = names(scene);
    for (index, name) in listed.iter().enumerate() {
        let message = if listed[..index].contains(name) {
            "is listed twice: remove one".to_owned()
        } else if named.contains(name) {
            continue;
        } else {
            format!("no light and no object has the group \"{name}\": {}", cure(&named))
        };
        fault(format!("{LISTED}/{index}"), message);
    }
    let other_sky = scene.sky_lights().find(|&light| groups.lights[light] != groups.sky);
    if let Some(light) = other_sky {
        fault(
            format!("/scene/lights/{light}"),
            "is of another light group than the sky light before it, and all sky lights together are one sky: give them the same group"
                .to_owned(),
        );
    }
    let runs = groups.runs_of_objects().len();
    if runs > MAX_LIGHT_GROUP_RUNS {
        fault(
            LISTED.to_owned(),
            format!(
                "the light group changes {runs} times from an object to the next: at most {MAX_LIGHT_GROUP_RUNS} times are allowed; put the objects of a group one after another"
            ),
        );
    }
    faults
}

/// The light groups of a scene.
fn names(scene: &Scene) -> BTreeSet<&LightGroup> {
    let of_objects = scene.objects.iter().filter_map(|object| object.light_group.as_ref());
    scene.lights.iter().filter_map(|light| light.options().group).chain(of_objects).collect()
}

fn cure(named: &BTreeSet<&LightGroup>) -> String {
    if named.is_empty() {
        return "give a light a \"group\", or an object that shines a \"light_group\"".to_owned();
    }
    let quoted: Vec<String> = named.iter().map(|name| format!("\"{name}\"")).collect();
    format!("choose from {}", quoted.join(", "))
}
