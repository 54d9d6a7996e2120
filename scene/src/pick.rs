//! Finds the surface that is seen at a point of a picture, and where the job file has it.

use language::has_value;
use math::real::Vec3;
use picture::animation::FrameError;
use picture::job::Job;
use picture::json_text;
use trace::integrator::Integrator;

/// Surface at a point of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Pick {
    /// Index of the object, as in the object layer of an EXR.
    pub object: usize,
    /// Its name.
    pub name: Option<String>,
    /// JSON pointer to the object in the job file.
    pub pointer: String,
    /// Name of the material there.
    pub material: Option<String>,
    /// JSON pointer to the material in the job file; `None` for the default, which is not written.
    pub material_pointer: Option<String>,
    /// The point.
    pub position: Vec3<f32>,
    /// Normal, toward the viewer's side.
    pub normal: Vec3<f32>,
    /// Distance from the camera, along the ray.
    pub distance: f32,
}

/// Surface of a job at a frame and a point of its picture, each coordinate from 0 to 1, from the top left; `None` where
/// there is none. `text` is the job's file.
pub fn pick(text: &str, job: &Job, frame: u32, [x, y]: [f32; 2]) -> Result<Option<Pick>, FrameError> {
    let at_frame = job.at(frame)?;
    let film = at_frame.image().film();
    let (x, y) = (x * film.width as f32, y * film.height as f32);
    let Some(seen) = Integrator::new(&at_frame).seen_at(x, y) else { return Ok(None) };
    let in_scene = format!("/scene/objects/{}", seen.object);
    let material = seen.slot.and_then(|slot| job.material_pointer(slot));
    let name = material.as_deref().and_then(|pointer| pointer.strip_prefix("/scene/materials/"));
    Ok(Some(Pick {
        object: seen.object,
        name: at_frame.scene().objects.get(seen.object).and_then(|object| object.name.clone()),
        pointer: at_frame.pointer_in_document(&in_scene),
        material: name.map(json_text::unescape),
        material_pointer: material.filter(|pointer| has_value(text, pointer)),
        position: seen.position,
        normal: seen.normal,
        distance: seen.distance,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIEW: &str = r#""camera": { "position": [0, 0, 5], "look_at": [0, 0, 0], "fov": 60 }"#;

    fn picked(scene: &str, at: [f32; 2]) -> Option<Pick> {
        let text = format!(
            "{{ // A comment.\n \"scene\": {{ {VIEW}, {scene} }}, \"image\": {{ \"width\": 100, \"height\": 100 }} }}"
        );
        let job = language::parse(text.as_bytes()).unwrap_or_else(|error| panic!("{error}"));
        let pick = pick(&text, &job, 0, at).expect("a frame");
        for pointer in pick.iter().flat_map(|pick| [Some(&pick.pointer), pick.material_pointer.as_ref()]).flatten() {
            assert!(has_value(&text, pointer), "{pointer} is not in {text}");
        }
        pick
    }

    fn pointers(scene: &str, at: [f32; 2]) -> (String, Option<String>, Option<String>) {
        let pick = picked(scene, at).expect("a surface");
        (pick.pointer, pick.material, pick.material_pointer)
    }

    #[test]
    fn the_nearest_object_is_picked_with_its_material() {
        let scene = r#""materials": { "a/b": { "flat": { "color": [1, 0, 0] } } }, "objects": [
            { "shape": { "plane": { "normal": [0, 0, 1], "offset": -1 } } },
            { "name": "ball", "material": "a/b", "shape": { "sphere": { "radius": 1 } } }]"#;
        let ball = picked(scene, [0.5, 0.5]).expect("the ball");
        assert_eq!((ball.object, ball.name.as_deref(), &*ball.pointer), (1, Some("ball"), "/scene/objects/1"));
        assert_eq!(ball.material.as_deref(), Some("a/b"));
        assert_eq!(ball.material_pointer.as_deref(), Some("/scene/materials/a~1b"));
        assert!((ball.distance - 4.0).abs() < 1e-4 && (ball.position.z - 1.0).abs() < 1e-4, "{ball:?}");
        assert!(ball.normal.z > 0.999, "{ball:?}");
        let wall = picked(scene, [0.05, 0.9]).expect("the wall");
        assert_eq!((wall.object, &*wall.pointer, wall.name), (0, "/scene/objects/0", None));
        assert_eq!((wall.material, wall.material_pointer), (None, None), "a default is not written");
        assert!(wall.position.x < 0.0 && wall.position.y < 0.0, "left and below: {:?}", wall.position);
    }

    #[test]
    fn nothing_is_picked_where_nothing_is_hit() {
        assert_eq!(picked(r#""objects": [{ "shape": { "sphere": { "radius": 1 } } }]"#, [0.0, 0.0]), None);
    }

    #[test]
    fn the_painted_part_has_its_own_material() {
        let scene = r#""objects": [{ "material": { "flat": { "color": [0, 0, 0] } }, "shape": { "union": { "of": [
            { "paint": { "material": { "flat": { "color": [1, 1, 1] } }, "child": { "sphere": { "radius": 1 } } } },
            { "translate": { "by": [2, 0, 0], "child": { "sphere": { "radius": 0.5 } } } }] } } }]"#;
        let (object, name, material) = pointers(scene, [0.5, 0.5]);
        assert_eq!((&*object, name), ("/scene/objects/0", None));
        assert_eq!(material.as_deref(), Some("/scene/objects/0/shape/union/of/0/paint/material"));
        let (_, _, material) = pointers(scene, [0.85, 0.5]);
        assert_eq!(material.as_deref(), Some("/scene/objects/0/material"));
    }

    #[test]
    fn objects_of_groups_and_used_shapes_lead_to_where_they_are_written() {
        let scene = r#""numbers": { "r": 1 }, "shapes": { "ball": { "paint": { "material": { "flat": { "color": [1, 0, 0] } },
            "child": { "sphere": { "radius": { "expr": "size" } } } } } },
            "objects": [{ "shape": { "translate": { "by": [0, 9, 0], "child": { "sphere": { "radius": 1 } } } } }],
            "groups": [{ "by": [0, 0, 0], "groups": [{ "by": [0, 0, 0.5], "objects": [
                { "shape": { "translate": { "by": [3, 0, 0], "child": { "sphere": { "radius": 0.1 } } } } },
                { "shape": { "use": { "shape": "ball", "with": { "size": "r" } } } }] }] }]"#;
        let (object, name, material) = pointers(scene, [0.5, 0.5]);
        assert_eq!((&*object, name), ("/scene/groups/0/groups/0/objects/1", None));
        assert_eq!(material.as_deref(), Some("/scene/shapes/ball/paint/material"));
    }

    #[test]
    fn every_object_of_the_shipped_scenes_that_is_picked_is_in_the_file() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
        let mut count = 0;
        for entry in std::fs::read_dir(folder).expect("scenes").flatten() {
            if entry.path().extension().is_none_or(|extension| extension != "json") {
                continue;
            }
            let text = std::fs::read_to_string(entry.path()).expect("a scene");
            let job = language::parse(text.as_bytes()).expect("a valid scene");
            for at in [[0.5, 0.5], [0.3, 0.8]] {
                let Some(pick) = pick(&text, &job, 0, at).expect("a frame") else { continue };
                let path = entry.path();
                assert!(has_value(&text, &pick.pointer), "{}: {pick:?}", path.display());
                count += 1;
            }
        }
        assert!(count > 30, "only {count} surfaces were picked");
    }
}
