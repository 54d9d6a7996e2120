//! Groups, paths, a camera that looks ahead, environments, visibility, shadow catchers and names of objects.

use std::f32::consts::PI;

use scene::real::{Real, vec3};
use scene::{Integrator, Job, ParseError, parse};
use serde_json::{Value, json};

fn job(job: &Value) -> Job {
    parse(job.to_string().as_bytes()).unwrap_or_else(|error| panic!("{job}\n{error}"))
}

fn errors(job: &Value) -> Vec<String> {
    match parse(job.to_string().as_bytes()) {
        Err(ParseError::Invalid(errors)) => {
            errors.iter().map(|error| format!("{}: {}", error.pointer, error.message)).collect()
        }
        other => panic!("{job}\n{other:?}"),
    }
}

/// Red, green, blue and alpha of a pixel of a frame.
fn pixel(job: &Job, frame: u32, x: u16, y: u16) -> [f32; 4] {
    let at_frame = job.at(frame).unwrap();
    let seen = Integrator::new(&at_frame).pixel(f32::from(x), f32::from(y));
    [seen.color.x, seen.color.y, seen.color.z, seen.alpha]
}

/// All pixels of a frame.
fn picture(job: &Job, frame: u32) -> Vec<[f32; 4]> {
    let (width, height) = (job.image.width as u16, job.image.height as u16);
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| pixel(job, frame, x, y)).collect()
}

fn is_near(a: &[[f32; 4]], b: &[[f32; 4]]) -> bool {
    a.iter().flatten().zip(b.iter().flatten()).all(|(a, b)| (a - b).abs() < 2e-3)
}

fn scene(scene: Value) -> Value {
    let mut whole = json!({ "camera": { "position": [0, 1, 6], "look_at": [0, 0, 0] },
        "objects": [{ "shape": { "plane": { "normal": [0, 1, 0], "offset": -1 } } }] });
    let Value::Object(scene) = scene else { panic!("{scene}") };
    whole.as_object_mut().unwrap().extend(scene);
    json!({ "scene": whole, "image": { "width": 12, "height": 8, "samples": 1 }, "frames": { "count": 3, "fps": 1 } })
}

fn ball(at: [f64; 3], radius: f64) -> Value {
    json!({ "translate": { "by": at, "child": { "sphere": { "radius": radius } } } })
}

/// A texture without edges, so that rounding changes no pixel visibly.
fn gradual() -> Value {
    json!({ "diffuse": { "kd": { "gradient": {
        "by": { "position": { "from": [0, -1, 0], "to": [0.3, 1, 0] } }, "ramp": [[0, "#26304f"], [1, "#ffd9a0"]]
    } } } })
}

fn red() -> Value {
    json!({ "flat": { "color": [1, 0, 0] } })
}

#[test]
fn a_group_moves_objects_and_lights_as_one() {
    let group = |more: Value| {
        let mut group = json!({
            "objects": [{ "material": gradual(), "shape": ball([0.5, 0.2, 0.0], 0.7) }],
            "lights": [{ "spot": { "position": [0.5, 3, 1], "direction": [0, -3, -1], "color": [9, 9, 9] } },
                { "point": { "position": [-2, 1, 0], "color": [3, 3, 4] } },
                { "directional": { "direction": [1, 2, 0.5], "color": [0.2, 0.1, 0.1] } }] });
        let hidden = json!({ "shape": ball([0.0, -60.0, 0.0], 1.0), "visible": { "camera": false, "shadow": false } });
        group.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        job(&scene(json!({ "lights": [], "objects": [hidden], "groups": [group] })))
    };
    let plain = group(json!({}));
    assert!(picture(&plain, 0).iter().any(|pixel| pixel[0] > 0.2));
    // The picture is the same if the camera moves with the group.
    for placement in [
        json!({ "by": [3, 1, -2] }),
        json!({ "degrees": [10, 70, -20] }),
        json!({ "by": [3, 1, -2], "degrees": 50, "axis": [1, 1, 0], "about": [0.5, 2, 1] }),
    ] {
        let mut with_camera = placement.clone();
        with_camera["camera"] = json!(true);
        let moved = group(with_camera);
        let background = |pixels: &[[f32; 4]]| pixels.iter().filter(|pixel| pixel[2] > 0.99).count();
        let (a, b) = (picture(&plain, 0), picture(&moved, 0));
        assert_eq!(background(&a), background(&b), "{placement}");
        let on_ball = |pixels: &[[f32; 4]]| pixels.iter().filter(|pixel| pixel[2] < 0.9).copied().collect::<Vec<_>>();
        // The normal is rounded in other coordinates.
        let differs = |(a, b): (&[f32; 4], &[f32; 4])| a.iter().zip(b).any(|(a, b)| (a - b).abs() > 0.01);
        assert!(
            !on_ball(&a).iter().zip(&on_ball(&b)).any(differs),
            "{placement}\n{:?}\n{:?}",
            on_ball(&a),
            on_ball(&b)
        );
        assert!(!is_near(&a, &picture(&group(placement.clone()), 0)), "{placement}");
    }
}

#[test]
fn groups_in_groups_move_with_them() {
    let inner = |objects: Value| json!({ "by": [1, 0, 0], "objects": objects });
    let object = || json!([{ "material": red(), "shape": ball([0.0, 0.0, 0.0], 0.4) }]);
    let nested = job(&scene(json!({ "groups": [{ "degrees": [0, 0, 90], "groups": [inner(object())] }] })));
    let flat = job(&scene(json!({ "groups": [{ "by": [0, 1, 0], "objects": object() }] })));
    let distance = |job: &Job, p| job.at(0).unwrap().scene().objects[1].shape.distance(p);
    for p in [vec3(0.0_f32, 1.0, 0.0), vec3(1.0, 0.0, 0.3)] {
        assert!((distance(&nested, p) - distance(&flat, p)).abs() < 1e-5);
    }
    let turns = json!({ "keys": [[0, 0], [2, 180]] });
    let moving = job(&scene(json!({ "groups": [
        { "degrees": turns, "axis": [0, 0, 1], "groups": [inner(object())] } ] })));
    let at = |frame, p| moving.at(frame).unwrap().scene().objects[1].shape.distance(p);
    assert!(
        (at(1, vec3(0.0_f32, 1.0, 0.0)) + 0.4).abs() < 1e-4 && (at(2, vec3(-1.0_f32, 0.0, 0.0)) + 0.4).abs() < 1e-4
    );
}

#[test]
fn errors_in_groups_point_into_them() {
    let wrong = scene(json!({ "groups": [
        { "name": "", "axis": [0, 1, 0], "objects": [{ "name": "lid", "shape": { "round": { "radius": 0.1, "child": { "use": "missing" } } } }],
          "lights": [{ "sky": {} }], "by": [0, 1, 0] },
        { "degrees": 30, "objects": [{ "material": "gold", "shape": ball([0.0, 0.0, 0.0], 1.0) }, { "shape": ball([0.0, 0.0, 1.0], 1.0) }] },
        {}
    ] }));
    let reported = errors(&wrong);
    for (place, words) in [
        ("/scene/groups/0/name", "is empty"),
        ("/scene/groups/0/axis", "without `degrees`"),
        ("/scene/groups/0/lights/0", "environment"),
        ("/scene/groups/0/objects/0/shape/round/child/use", "missing"),
        ("/scene/groups/1/degrees", "one angle"),
        ("/scene/groups/1/objects/0/material", "gold"),
        ("/scene/groups/2", "is empty"),
    ] {
        let found = reported.iter().filter(|error| error.starts_with(&format!("{place}: "))).collect::<Vec<_>>();
        assert!(found.len() == 1 && found[0].contains(words), "{place}, {words}: {reported:#?}");
    }
}

#[test]
fn an_error_in_a_later_frame_of_a_group_points_into_it() {
    let late = json!({ "expr": "10 / (1 - t)" });
    let wrong = scene(json!({ "groups": [{ "by": [late, 0, 0], "objects": [{ "shape": ball([0.0; 3], 1.0) }] }] }));
    let reported = errors(&wrong);
    assert!(reported[0].starts_with("/scene/groups/0/by/0") && reported[0].contains("frame 1"), "{reported:?}");
}

#[test]
fn a_camera_on_a_path_looks_ahead_and_leans_into_turns() {
    let ring = json!([[6, 1, 0], [0, 1, -6], [-6, 1, 0], [0, 1, 6]]);
    let around = |ahead: f64, bank: f64| {
        let path = json!({ "through": ring, "closed": true, "keys": [[0, 0], [4, 1]], "loop": "repeat" });
        let look_at = json!({ "ahead": ahead, "bank": bank });
        job(&scene(json!({ "camera": { "position": { "path": path }, "look_at": look_at, "fov": 60 } })))
    };
    let view = |job: &Job, frame| {
        let at_frame = job.at(frame).unwrap();
        let view = at_frame.scene().camera.view(100, 100);
        let [middle, top] = [(50.0_f32, 50.0), (50.0, 0.0)].map(|(x, y)| view.ray(x, y).direction);
        (view.origin(), middle, (top - middle * top.dot(middle)).normalize())
    };
    // Frame 1 is at the second point, on a turn to the left.
    let (origin, forward, up) = view(&around(0.05, 0.0), 1);
    assert!((origin - vec3(0.0, 1.0, -6.0)).length() < 1e-3, "{origin:?}");
    assert!(forward.x < -0.99 && up.y > 0.99, "{forward:?} {up:?}");
    // On a circle it would turn by 90 degrees in a second and lean by 18; the curve is tighter at its points.
    let (_, _, leaning) = view(&around(0.5, 0.2), 1);
    let degrees = Real::atan2((leaning.x * leaning.x + leaning.z * leaning.z).sqrt(), leaning.y) * 180.0 / PI;
    assert!((18.0..27.0).contains(&degrees) && leaning.z > 0.0, "{leaning:?} {degrees}");
    let reported = errors(&scene(json!({ "camera": { "position": [0, 1, 5], "look_at": { "ahead": 1 } } })));
    assert!(reported[0].starts_with("/scene/camera/look_at: ") && reported[0].contains("path"), "{reported:?}");
}

#[test]
fn frames_of_paths_and_groups_do_not_depend_on_their_order() {
    let path = json!({ "path": { "through": [[-1, 0, 0], [0, 1, 0], [1, 0, 0]], "keys": [[0, 0], [2, 1]], "ease": "smooth" } });
    let moving =
        job(&scene(json!({ "groups": [{ "by": path, "objects": [{ "material": red(), "shape": ball([0.0; 3], 0.5) }],
        "lights": [{ "point": { "position": [0, 2, 0] } }] }] })));
    let key = |frame| moving.at(frame).unwrap().pixels_cache_key();
    let forth: Vec<_> = (0..3).map(key).collect();
    let back: Vec<_> = (0..3).rev().map(key).collect();
    assert!(forth.iter().eq(back.iter().rev()) && forth[0] != forth[1]);
}

#[test]
fn mirrors_meet_the_environment_and_the_camera_the_background() {
    let mirror = json!({ "surface": { "base_color": [1, 1, 1], "metallic": 1, "roughness": 0 } });
    let of = |background: Value| {
        job(&scene(json!({ "background": background, "environment": { "color": [0.2, 0.9, 0.3] }, "lights": [],
            "objects": [{ "material": mirror, "shape": ball([0.0; 3], 1.5) }] })))
    };
    for (background, corner) in
        [(json!({ "color": [1, 0, 0] }), [1.0, 0.0, 0.0, 1.0]), (json!("transparent"), [0.0; 4])]
    {
        let job = of(background);
        assert_eq!(pixel(&job, 0, 0, 0), corner);
        let [r, g, b, a] = pixel(&job, 0, 6, 4);
        assert!((r - 0.2).abs() < 0.01 && (g - 0.9).abs() < 0.01 && (b - 0.3).abs() < 0.01 && a == 1.0);
    }
    let reported = errors(&scene(json!({ "environment": "transparent" })));
    assert_eq!(reported, ["/scene/environment: emits no light: choose a color, a gradient or a day"]);
}

#[test]
fn each_kind_of_ray_sees_what_is_visible_to_it() {
    // Seen from above: a floor, and a ball high over its middle.
    let of = |visible: Value, floor: Value| {
        job(&scene(json!({
            "camera": { "position": [0, 6, 0.1], "look_at": [0, 0, 0] }, "background": { "color": [0, 0, 1] },
            "lights": [{ "directional": { "direction": [1, 1, 0] } }],
            "objects": [
                { "material": floor, "shape": { "plane": { "normal": [0, 1, 0], "offset": -1 } } },
                { "material": red(), "shape": ball([0.0, 0.5, 0.0], 0.6), "visible": visible } ] })))
    };
    let matte = || json!({ "diffuse": { "kd": [0.8, 0.8, 0.8], "ambient": [0, 0, 0] } });
    let mirror = || json!({ "surface": { "base_color": [1, 1, 1], "metallic": 1, "roughness": 0 } });
    let is_red = |pixel: &[f32; 4]| pixel[0] > 0.5 && pixel[1] < 0.1;
    let is_dark = |pixel: &[f32; 4]| pixel[0] < 0.05 && pixel[2] < 0.05;
    let count = |visible: Value, floor: Value, is: fn(&[f32; 4]) -> bool| {
        picture(&of(visible, floor), 0).iter().filter(|pixel| is(pixel)).count()
    };
    assert!(count(json!({}), matte(), is_red) > 0 && count(json!({}), matte(), is_dark) > 0);
    assert_eq!(count(json!({ "camera": false }), matte(), is_red), 0);
    assert!(count(json!({ "camera": false }), matte(), is_dark) > 0, "it still has a shadow");
    assert_eq!(count(json!({ "shadow": false }), matte(), is_dark), 0);
    assert!(count(json!({ "shadow": false }), matte(), is_red) > 0);
    assert!(count(json!({ "camera": false }), mirror(), is_red) > 0, "the mirror shows it");
    assert_eq!(count(json!({ "camera": false, "reflection": false }), mirror(), is_red), 0);
}

#[test]
fn a_shadow_catcher_shows_shadows_alone() {
    let of = |background: Value, opacity: f64| {
        job(&scene(json!({
            "camera": { "position": [0, 6, 0.1], "look_at": [0, 0, 0] }, "background": background,
            "lights": [{ "directional": { "direction": [1, 1, 0] } }],
            "objects": [
                { "material": { "shadow_catcher": { "opacity": opacity } }, "shape": { "plane": { "normal": [0, 1, 0], "offset": -1 } } },
                { "material": red(), "shape": ball([0.0, 0.5, 0.0], 0.6), "visible": { "camera": false } } ] })))
    };
    let clear = picture(&of(json!("transparent"), 0.75), 0);
    assert!(clear.iter().all(|[r, g, b, a]| [*r, *g, *b] == [0.0; 3] && (*a == 0.0 || (a - 0.75).abs() < 1e-6)));
    let shadows = clear.iter().filter(|pixel| pixel[3] > 0.5).count();
    assert!(shadows > 3 && shadows < 40, "{shadows}");
    let over = picture(&of(json!({ "color": [0.4, 0.6, 0.8] }), 0.75), 0);
    for (clear, over) in clear.iter().zip(&over) {
        let kept = 1.0 - clear[3];
        let want = [0.4 * kept, 0.6 * kept, 0.8 * kept, 1.0];
        assert!(is_near(&[*over], &[want]), "{over:?} {want:?}");
    }
}

#[test]
fn errors_and_warnings_name_objects() {
    let far = json!([{ "name": "left leg", "shape": { "sphere": { "radius": -1 } } }, { "shape": { "sphere": {} } }]);
    let reported = errors(&scene(json!({ "objects": far })));
    assert!(reported.iter().any(|error| error.ends_with("(in object \"left leg\")")), "{reported:?}");
    assert!(reported.iter().any(|error| !error.contains("in object")), "{reported:?}");
    let inside = json!([{ "name": "the moon", "shape": { "sphere": { "radius": 20 } } }]);
    let warnings = scene::warnings(&job(&scene(json!({ "objects": inside }))));
    assert!(warnings.iter().any(|warning| warning.contains("object 0 (\"the moon\")")), "{warnings:?}");
    for wrong in ["", "two\nlines"] {
        let reported = errors(&scene(json!({ "objects": [{ "name": wrong, "shape": ball([0.0; 3], 1.0) }] })));
        assert!(reported[0].starts_with("/scene/objects/0/name: "), "{reported:?}");
    }
}

#[test]
fn a_region_has_the_pixels_of_the_whole_picture() {
    let mut whole = scene(json!({ "objects": [{ "shape": ball([0.0; 3], 1.3) }], "lights": [{ "sky": {} }] }));
    whole["image"]["samples"] = json!(3);
    let mut part = whole.clone();
    part["image"]["region"] = json!([3, 2, 7, 5]);
    let (whole, part) = (job(&whole), job(&part));
    let film = part.image.film();
    assert_eq!((film.width, film.height, [part.image.width, part.image.height]), (7, 5, [12, 8]));
    for (x, y) in (0..5).flat_map(|y| (0..7).map(move |x| (x, y))) {
        assert_eq!(pixel(&part, 0, x, y), pixel(&whole, 0, x + 3, y + 2), "{x}, {y}");
    }
    for (region, words) in
        [(json!([3, 2, 10, 5]), "12×8"), (json!([0, 0, 0, 4]), "width and height"), (json!([0.5, 0, 1, 1]), "0.5")]
    {
        let mut wrong = scene(json!({}));
        wrong["image"]["region"] = region;
        let reported = errors(&wrong);
        assert!(
            reported.len() == 1 && reported[0].starts_with("/image/region") && reported[0].contains(words),
            "{reported:?}"
        );
    }
}
