//! Warnings: valid scenes with probable mistakes get one; the shipped scenes have none.

use std::path::{Path, PathBuf};

use scene::Job;

fn job(text: &str) -> Job {
    scene::parse(text.as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}\n{text}"))
}

/// A job with some objects: `scene` is added to its scene after the camera, `more` after its image.
fn seen_from(camera: &str, scene: &str, more: &str) -> Job {
    job(&format!(
        r#"{{ "scene": {{ "camera": {{ {camera} }}, {scene} }}, "image": {{ "width": 64, "height": 48 }}{more} }}"#
    ))
}

const CAMERA: &str = r#""position": [0, 0, 5], "look_at": [0, 0, 0]"#;
const SPHERE: &str = r#"{ "shape": { "sphere": { "radius": 1 } } }"#;

fn of(scene: &str) -> Vec<String> {
    scene::warnings(&seen_from(CAMERA, scene, ""))
}

fn of_objects(objects: &str) -> Vec<String> {
    of(&format!(r#""objects": [{objects}]"#))
}

fn filled(material: &str, more: &str) -> Vec<String> {
    of(&format!(r#""objects": [{{ "material": {material}, "shape": {{ "sphere": {{ "radius": 1 }} }} }}]{more}"#))
}

#[track_caller]
fn one(warnings: &[String], words: &[&str]) {
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    for word in words {
        assert!(warnings[0].contains(word), "{} does not contain {word:?}", warnings[0]);
    }
}

#[track_caller]
fn none(warnings: &[String]) {
    assert_eq!(warnings, [""; 0]);
}

fn job_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            job_files(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "json") {
            found.push(path);
        }
    }
}

#[test]
fn shipped_scenes_have_no_warnings() {
    let mut files = Vec::new();
    job_files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes"), &mut files);
    assert!(files.len() > 10, "{files:?}");
    let reported: Vec<String> = files
        .iter()
        .flat_map(|file| {
            let warnings = scene::warnings(&job(&std::fs::read_to_string(file).unwrap()));
            warnings.into_iter().map(|warning| format!("{}: {warning}", file.display()))
        })
        .collect();
    assert!(reported.is_empty(), "{}", reported.join("\n"));
}

#[test]
fn camera_inside_an_opaque_object_is_reported() {
    let around = |material: &str| {
        let large = format!(r#"{{ "material": {material}, "shape": {{ "sphere": {{ "radius": 9 }} }} }}"#);
        of_objects(&format!("{SPHERE}, {large}"))
    };
    one(&around(r#"{ "diffuse": {} }"#), &["camera is inside object 1", "camera.position"]);
    none(&around(r#"{ "surface": { "transmission": 1 } }"#));
    none(&around(r#"{ "volume": { "density": 0.1 } }"#));
    let painted = r#"{ "shape": { "paint": { "material": { "surface": { "transmission": 1 } },
        "child": { "sphere": { "radius": 9 } } } } }"#;
    none(&of_objects(painted));
    let room = r#"{ "shape": { "onion": { "thickness": 1, "child": { "sphere": { "radius": 9 } } } } }"#;
    none(&of_objects(room));
    one(&of_objects(r#"{ "shape": { "plane": { "normal": [0, 1, 0], "offset": 2 } } }"#), &["inside object 0"]);
}

#[test]
fn orthographic_picture_that_starts_inside_an_object_is_reported() {
    let of = |height: f32| {
        let camera = format!(
            r#""position": [0, 4, 5], "look_at": [0, 0, 0], "projection": {{ "orthographic": {{ "height": {height} }} }}"#
        );
        let floor = r#"{ "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } }"#;
        scene::warnings(&seen_from(&camera, &format!(r#""objects": [{SPHERE}, {floor}]"#), ""))
    };
    none(&of(3.0));
    one(&of(30.0), &["starts inside object 1", "back"]);
}

#[test]
fn nothing_in_view_is_reported_for_every_projection() {
    let at = |x: f32, y: f32, z: f32| {
        format!(
            r#""objects": [{{ "shape": {{ "translate": {{ "by": [{x}, {y}, {z}],
               "child": {{ "sphere": {{ "radius": 1 }} }} }} }} }}]"#
        )
    };
    let cameras = [
        CAMERA.to_owned(),
        format!(r#"{CAMERA}, "projection": {{ "orthographic": {{ "height": 4 }} }}"#),
        format!(r#"{CAMERA}, "up": [1, 1, 0], "fov": 120"#),
    ];
    for camera in &cameras {
        let of = |x, y, z| scene::warnings(&seen_from(camera, &at(x, y, z), ""));
        none(&of(0.0, 0.0, 0.0));
        none(&of(1.0, -1.0, 0.0));
        one(&of(0.0, 0.0, 50.0), &["outside the view", "look_at"]);
        one(&of(90.0, 0.0, 1.0), &["outside the view"]);
        one(&of(0.0, -90.0, 1.0), &["outside the view"]);
        one(&of(0.0, 0.0, -2000.0), &["max_distance", "1000"]);
        assert!(of(0.0, 0.0, -990.0).is_empty());
    }
    let panorama = |x| {
        let camera = format!(r#"{CAMERA}, "projection": "panorama""#);
        let text = format!(
            r#"{{ "scene": {{ "camera": {{ {camera} }}, {} }}, "image": {{ "width": 64, "height": 32 }} }}"#,
            at(x, 0.0, 50.0)
        );
        scene::warnings(&job(&text))
    };
    none(&panorama(0.0));
    one(&panorama(5000.0), &["max_distance"]);
}

#[test]
fn floor_is_out_of_view_only_above_the_horizon() {
    let floor = r#""objects": [{ "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } }],
        "fog": { "density": 0.1 }"#;
    let toward = |y: f32| {
        let camera = format!(r#""position": [0, 1, 0], "look_at": [3, {y}, 4], "fov": 40"#);
        scene::warnings(&seen_from(&camera, floor, ""))
    };
    none(&toward(1.0));
    none(&toward(2.5));
    one(&toward(5.0), &["outside the view"]);
}

#[test]
fn objects_seen_in_later_frames_do_not_warn() {
    let moving = |last: f32| {
        let objects = format!(
            r#""objects": [{{ "shape": {{ "translate": {{ "by": [{{ "keys": [[0, 90], [1, {last}]] }}, 0, 0],
               "child": {{ "sphere": {{ "radius": 1 }} }} }} }} }}]"#
        );
        scene::warnings(&seen_from(CAMERA, &objects, r#", "frames": { "count": 11, "fps": 10 }"#))
    };
    none(&moving(0.0));
    one(&moving(80.0), &["outside the view"]);
}

#[test]
fn the_frame_of_a_warning_is_named() {
    let camera = r#""position": [0, 0, { "keys": [[0, 5], [1, 0.5]] }], "look_at": [0, 0, -9]"#;
    let objects = format!(r#""objects": [{SPHERE}]"#);
    let warnings = scene::warnings(&seen_from(camera, &objects, r#", "frames": { "count": 11, "fps": 10 }"#));
    one(&warnings, &["inside object 0", "(in frame 10)"]);
}

#[test]
fn rays_out_of_steps_are_reported_with_their_fraction() {
    let gyroid = |steps: u32| {
        of(&format!(
            r#""march": {{ "max_steps": {steps} }}, "objects": [{{ "shape": {{ "intersection": {{ "of": [
               {{ "gyroid": {{ "cell": 0.5, "thickness": 0.05 }} }}, {{ "sphere": {{ "radius": 1.5 }} }}] }} }} }}]"#
        ))
    };
    none(&gyroid(512));
    one(&gyroid(6), &[" % of the rays", "raise march.max_steps above 6"]);
}

#[test]
fn many_nodes_are_not_probed() {
    let sphere = r#"{ "sphere": { "radius": 1 } }"#;
    let many = vec![sphere; 60_000].join(",");
    none(&of(&format!(
        r#""march": {{ "max_steps": 7 }}, "objects": [{{ "shape": {{ "union": {{ "of": [{many}] }} }} }}]"#
    )));
}

#[test]
fn deeply_nested_copies_are_reported_and_not_evaluated() {
    let nested = |depth: usize| {
        let open = r#"{ "polar_repeat": { "count": 5, "child": "#.repeat(depth);
        of_objects(&format!(r#"{{ "shape": {open}{{ "sphere": {{ "radius": 1 }} }}{} }}"#, " } }".repeat(depth)))
    };
    none(&nested(2));
    one(&nested(63), &["one evaluation of object 0", "fewer copies"]);
}

#[test]
fn tiny_steps_are_reported_with_their_cause() {
    let displaced = |amplitude: f32| {
        of_objects(&format!(
            r#"{SPHERE}, {{ "shape": {{ "union": {{ "of": [{{ "sphere": {{ "radius": 1 }} }},
               {{ "translate": {{ "by": [1, 0, 0], "child": {{ "displace": {{ "amplitude": {amplitude},
                  "by": {{ "sine": {{ "frequency": 90 }} }}, "child": {{ "sphere": {{ "radius": 1 }} }} }} }} }} }}] }} }} }}"#
        ))
    };
    none(&displaced(0.1));
    one(&displaced(0.4), &["/scene/objects/1/shape/union/of/1/translate/child/displace", "1/37", "amplitude"]);
}

#[test]
fn lights_inside_opaque_objects_are_reported() {
    let inside = |light: &str| filled(r#"{ "surface": {} }"#, &format!(r#", "lights": [{light}]"#));
    let point = r#"{ "point": { "position": [0, 0, 0.1] } }"#;
    one(&inside(point), &["/scene/lights/0 is inside object 0", "move it"]);
    none(&filled(r#"{ "surface": { "transmission": 1 } }"#, &format!(r#", "lights": [{point}]"#)));
    none(&inside(r#"{ "point": { "position": [0, 0, 0.1], "shadow": false } }"#));
    none(&inside(r#"{ "point": { "position": [0, 9, 0] } }"#));
    // A ball around the object.
    none(&inside(r#"{ "sphere": { "position": [0, 0, 0], "radius": 1.2 } }"#));
    one(&inside(r#"{ "sphere": { "position": [0, 0, 0], "radius": 0.1 } }"#), &["/scene/lights/0 is inside object 0"]);
}

#[test]
fn paths_of_light_need_no_lights() {
    let path = r#", "lights": [], "integrator": { "path": {} }"#;
    none(&filled(r#"{ "diffuse": {} }"#, path));
    let dark = |more: &str| {
        filled(r#"{ "diffuse": {} }"#, &format!(r#"{path}, "environment": {{ "color": [0, 0, 0] }}{more}"#))
    };
    one(&dark(""), &["there is no light"]);
    let none_left = r#", "lights": [], "integrator": { "path": { "max_bounces": 1 } }"#;
    one(&filled(r#"{ "surface": { "transmission": 1 } }"#, none_left), &["integrator.path.max_bounces is 1"]);
}

#[test]
fn unused_lights_and_scenes_without_light_are_reported() {
    let flat = r##"{ "flat": { "color": "#808080" } }"##;
    let lit = r#", "lights": [{ "point": { "position": [0, 9, 0] } }]"#;
    none(&filled(flat, ""));
    none(&filled(flat, r#", "lights": []"#));
    one(&filled(flat, lit), &["lights have no effect"]);
    none(&filled(r#"{ "diffuse": {} }"#, lit));
    one(&filled(r#"{ "diffuse": {} }"#, r#", "lights": []"#), &["there is no light"]);
    none(&filled(r#"{ "diffuse": { "ambient": [1, 1, 1] } }"#, r#", "lights": []"#));
    none(&filled(r#"{ "surface": { "metallic": 1 } }"#, r#", "lights": []"#));
    let black = r#", "lights": [{ "point": { "position": [0, 9, 0], "color": [0, 0, 0] } }]"#;
    one(&filled(r#"{ "surface": {} }"#, black), &["all lights are black"]);
}

#[test]
fn a_volume_too_dense_is_reported_with_enough_steps() {
    let volume = |density: f32| filled(&format!(r#"{{ "volume": {{ "density": {density} }} }}"#), "");
    none(&volume(20.0));
    // 500 × the diagonal of a cube of 2, over 8.
    one(&volume(500.0), &["fills object 0", "48 steps", "raise its steps to 217"]);
    one(&volume(1e5), &["lower its density"]);
    one(&filled(r#"{ "clouds": { "noise": { "perlin": {} }, "density": 500, "steps": 8 } }"#, ""), &["object 0"]);
}

#[test]
fn glass_needs_two_bounces() {
    let glass = |bounces: u32| {
        let march = format!(r#", "march": {{ "max_bounces": {bounces} }}"#);
        filled(r#"{ "surface": { "transmission": 1 } }"#, &march)
    };
    none(&glass(2));
    one(&glass(1), &["inside glass", "max_bounces is 1"]);
    one(&glass(0), &["max_bounces is 0"]);
    none(&filled(r#"{ "surface": { "metallic": 1 } }"#, r#", "march": { "max_bounces": 0 }"#));
}

#[test]
fn colors_up_to_255_are_reported_with_the_fix() {
    let of = |material: &str| filled(material, "");
    let reported = of(r#"{ "surface": { "base_color": [255, 51, 0] } }"#);
    one(&reported, &["/surface/base_color", "object 0", "[1, 0.2, 0]", "\"#ff3300\""]);
    one(
        &of(r#"{ "diffuse": { "kd": { "checker": { "cell": 1, "colors": [[0, 0, 0], [200, 200, 200]] } } } }"#),
        &["colors/1"],
    );
    none(&of(r#"{ "surface": { "base_color": [1, 1, 0] } }"#));
    none(&of(r#"{ "surface": { "emission": [40, 40, 20] } }"#));
    none(&of(r#"{ "diffuse": { "kd": [0.5, 16.5, 0.1] } }"#));
}

#[test]
fn angles_in_radians_are_reported_with_their_degrees() {
    let rotated = |degrees: &str| {
        of_objects(&format!(
            r#"{{ "shape": {{ "rotate": {{ "degrees": {degrees}, "child": {{ "sphere": {{ "radius": 1 }} }} }} }} }}"#
        ))
    };
    one(&rotated("[0, 1.5708, 0]"), &["/scene/objects/0/shape/rotate/degrees", "[0, 90, 0]"]);
    one(&rotated("[0.7854, 0, 3.14159]"), &["[45, 0, 180]"]);
    for degrees in ["[0, 90, 0]", "[0, 0, 0]", "[1, 2, 3]", "[0.5, 0, 0]", "[0, 1.5708, 30]", "[7.5, 0, 0]"] {
        none(&rotated(degrees));
    }
    let seen = |fov: f32| {
        scene::warnings(&seen_from(&format!(r#"{CAMERA}, "fov": {fov}"#), &format!(r#""objects": [{SPHERE}]"#), ""))
    };
    one(&seen(0.8), &["/scene/camera/fov", "46"]);
    none(&seen(20.0));
}

#[test]
fn a_texture_that_does_not_follow_is_reported() {
    const CHECKERS: &str = r#"{ "flat": { "color": { "checker": { "cell": 1 } } } }"#;
    let moved = |material: &str, child: &str| {
        let objects = format!(
            r#""objects": [{{ "material": {material}, "shape": {{ "translate": {{
               "by": [{{ "keys": [[0, 0], [1, 1]] }}, 0, 0], "child": {child} }} }} }}]"#
        );
        scene::warnings(&seen_from(CAMERA, &objects, r#", "frames": { "count": 11, "fps": 10 }"#))
    };
    let sphere = r#"{ "sphere": { "radius": 1 } }"#;
    one(&moved(CHECKERS, sphere), &["/scene/objects/0/shape/translate", "paint"]);
    none(&moved(CHECKERS, &format!(r#"{{ "paint": {{ "material": {CHECKERS}, "child": {sphere} }} }}"#)));
    none(&moved(r##"{ "flat": { "color": "#808080" } }"##, sphere));
    none(&filled(CHECKERS, ""));
}

#[test]
fn an_empty_difference_is_reported() {
    let cut = |first: &str, second: &str| {
        of_objects(&format!(
            r#"{SPHERE}, {{ "shape": {{ "union": {{ "of": [{{ "difference": {{ "of": [{first}, {second}] }} }},
            {{ "sphere": {{ "radius": 0.5 }} }}] }} }} }}"#
        ))
    };
    let (small, large) = (r#"{ "sphere": { "radius": 1 } }"#, r#"{ "box": { "size": [3, 3, 3] } }"#);
    one(&cut(small, large), &["/scene/objects/1/shape/union/of/0/difference", "order"]);
    none(&cut(large, small));
    let thin = r#"{ "sphere": { "radius": 0.999 } }"#;
    none(&cut(small, thin));
    none(&cut(small, small));
}

#[test]
fn liquid_that_touches_its_glass_is_reported() {
    let liquid = |radius: f32| {
        let glass = r#""material": { "surface": { "transmission": 1 } }"#;
        of_objects(&format!(
            r#"{{ {glass}, "shape": {{ "onion": {{ "thickness": 0.2, "child": {{ "sphere": {{ "radius": 1 }} }} }} }} }},
               {{ {glass}, "shape": {{ "intersection": {{ "of": [{{ "sphere": {{ "radius": {radius} }} }},
                  {{ "plane": {{ "normal": [0, 1, 0], "offset": 0 }} }}] }} }} }}"#
        ))
    };
    one(&liquid(0.9), &["objects 0 and 1", "coincide", "thousandth"]);
    none(&liquid(0.92));
    none(&liquid(0.88));
}

#[test]
fn metal_with_a_transparent_background_is_reported() {
    let before = |material: &str, background: &str| filled(material, &format!(r#", "background": {background}"#));
    let (metal, glass) = (r#"{ "surface": { "metallic": 1 } }"#, r#"{ "surface": { "transmission": 1 } }"#);
    one(&before(metal, r#""transparent""#), &["/scene/background", "object 0"]);
    one(&before(glass, r#""transparent""#), &["/scene/background", "object 0"]);
    none(&before(r#"{ "surface": {} }"#, r#""transparent""#));
    none(&before(metal, r#"{ "color": [0, 0, 0] }"#));
}

#[test]
fn samples_without_visible_effect_are_reported() {
    let of = |samples: u32, more: &str, material: &str| {
        scene::warnings(&job(&format!(
            r#"{{ "scene": {{ "camera": {{ {CAMERA} }}, "objects": [{{ "material": {material},
               "shape": {{ "sphere": {{ "radius": 1 }} }} }}] }},
               "image": {{ "width": 64, "height": 48, "samples": {samples}{more} }} }}"#
        )))
    };
    let matte = r#"{ "diffuse": {} }"#;
    one(&of(257, "", matte), &["/image/samples is 257", "256"]);
    none(&of(256, "", matte));
    none(&of(1024, r#", "bits": 16"#, matte));
    none(&of(1024, r#", "format": "exr""#, matte));
    none(&of(1024, "", r#"{ "surface": {} }"#));
}

#[test]
fn scattered_copies_that_miss_their_shape_are_reported() {
    let scatter = |radius: f32| {
        format!(
            r#"{{ "scatter": {{ "of": [{{ "sphere": {{ "radius": 0.1 }} }}], "count": 200, "within": {{ "disc": {{ "radius": {radius} }} }},
                "on": {{ "union": {{ "of": [
                    {{ "box": {{ "size": [4, 1, 4] }} }},
                    {{ "translate": {{ "by": [0, -200, 0], "child": {{ "box": {{ "size": [90, 1, 90] }} }} }} }} ] }} }} }} }}"#
        )
    };
    let warnings = |shape: &str| {
        let text = format!(
            r#"{{ "scene": {{ "camera": {{ "position": [0, 3, 9], "look_at": [0, 0, 0] }}, "objects": [{{ "shape": {shape} }}] }},
                "image": {{ "width": 8, "height": 8 }} }}"#
        );
        scene::warnings(&scene::parse(text.as_bytes()).unwrap_or_else(|error| panic!("{error}")))
    };
    let missed = warnings(&scatter(2.2));
    assert!(
        missed.iter().any(|text| text.starts_with("/scene/objects/0/shape/scatter puts copies at a height of -199.5")),
        "{missed:?}"
    );
    let sound = warnings(&scatter(1.5));
    assert!(!sound.iter().any(|text| text.contains("at a height of")), "{sound:?}");
}

#[test]
fn blurs_of_few_samples_and_ambient_light_on_paths_get_one() {
    const PATH: &str = r#"{ "path": { "max_bounces": 4 } }"#;
    let lens = format!("{CAMERA}, \"lens\": {{ \"aperture\": 0.2, \"focus\": 4 }}");
    let blurred = |samples: &str| {
        let text = format!(
            r#"{{ "scene": {{ "camera": {{ {lens} }}, "objects": [{SPHERE}] }},
                "image": {{ "width": 64, "height": 48, "samples": {samples} }} }}"#
        );
        scene::warnings(&job(&text))
    };
    one(&blurred("4"), &["/image/samples is 4", "the lens blurs", "16 or more"]);
    none(&blurred("16"));
    none(&blurred(r#"{ "adaptive": { "min": 4, "max": 64 } }"#));
    let of_paths = |integrator: &str, diffuse: &str| {
        of(&format!(
            r#""integrator": {integrator}, "objects": [{{ "shape": {{ "sphere": {{ "radius": 1 }} }}, "material": {{ "diffuse": {{ {diffuse} }} }} }}]"#
        ))
    };
    one(&of_paths(PATH, r#""ambient": [1, 1, 1]"#), &["/scene/objects/0/material has ambient light", "`emission`"]);
    one(&of_paths(PATH, r#""ka": [1, 0, 0]"#), &["/scene/objects/0/material", "`ka`"]);
    none(&of_paths(PATH, r#""kd": [1, 0, 0]"#));
    none(&of_paths(r#""direct""#, r#""ambient": [1, 1, 1]"#));
}
