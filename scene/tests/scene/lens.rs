//! Lenses in jobs: what is blurred and what is not, keys, animation and warnings.

use scene::real::{Vec3, vec3};
use scene::{Integrator, Job};
use serde_json::{Value, json};

const SIZE: u32 = 24;

/// A job of white balls of radius 0.5 before black, as a camera with these members sees them.
fn job(camera: &Value, balls: &[[f32; 3]], frames: u32) -> Job {
    let ball = |at: &[f32; 3]| {
        json!({ "material": { "flat": { "color": [1, 1, 1] } },
            "shape": { "translate": { "by": at, "child": { "sphere": { "radius": 0.5 } } } } })
    };
    let mut members = json!({ "position": [0, 0, 6], "look_at": [0, 0, 0], "fov": 30 });
    for (key, value) in camera.as_object().expect("members of a camera") {
        members[key] = value.clone();
    }
    let text = json!({
        "scene": { "camera": members, "background": { "color": [0, 0, 0] },
            "objects": balls.iter().map(ball).collect::<Vec<_>>() },
        "image": { "width": SIZE, "height": SIZE, "samples": 64 }, "frames": { "count": frames, "fps": 1 } })
    .to_string();
    scene::parse(text.as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}\n{text}"))
}

fn with_lens(lens: &Value) -> Job {
    job(&json!({ "lens": lens }), &[[0.0; 3]], 1)
}

/// Bits of all pixels of a frame.
fn pixels(job: &Job, frame: u32) -> Vec<[u32; 4]> {
    let at_frame = job.at(frame).expect("a frame");
    let integrator = Integrator::new(&at_frame);
    let pixel = |index: u32| {
        let seen = integrator.pixel((index % SIZE) as f32, (index / SIZE) as f32);
        [seen.color.x, seen.color.y, seen.color.z, seen.alpha].map(f32::to_bits)
    };
    (0..SIZE * SIZE).map(pixel).collect()
}

/// Number of pixels that are neither black nor white.
fn gray_pixels(job: &Job) -> usize {
    pixels(job, 0).into_iter().filter(|pixel| (0.05..0.95).contains(&f32::from_bits(pixel[0]))).count()
}

#[test]
fn a_lens_of_aperture_0_is_a_pinhole_to_the_bit() {
    let pinhole = job(&json!({}), &[[0.0; 3]], 1);
    let closed = with_lens(&json!({ "aperture": 0, "focus": 3, "blades": 7, "turn": 20 }));
    assert_eq!(pixels(&pinhole, 0), pixels(&closed, 0));
    assert_eq!(pinhole.cache_key(0), closed.cache_key(0));
    assert_ne!(pinhole.cache_key(0), with_lens(&json!({ "aperture": 1e-3, "focus": 3 })).cache_key(0));
}

#[test]
fn turning_a_circle_changes_no_key() {
    let rotated = |turn: f32| with_lens(&json!({ "aperture": 0.3, "focus": 3, "turn": turn })).cache_key(0);
    assert_eq!(rotated(0.0), rotated(25.0));
}

#[test]
fn what_is_in_focus_is_as_sharp_as_with_a_pinhole_and_the_rest_is_blurred() {
    let sharp = gray_pixels(&job(&json!({}), &[[0.0; 3]], 1));
    let at = |focus: Value| gray_pixels(&with_lens(&json!({ "aperture": 1, "focus": focus })));
    // The edge of the ball is a little nearer than its center.
    let in_focus = at(json!(5.96));
    assert!(in_focus <= sharp + 4, "{in_focus} and {sharp}");
    assert!(at(json!(3)) > 3 * sharp && at(json!(40)) > 3 * sharp, "{} {} {sharp}", at(json!(3)), at(json!(40)));
    assert_eq!(at(json!([4, 1, 0.04])), in_focus, "a point beside the axis, in the same plane");
}

#[test]
fn an_f_stop_and_a_focal_length_are_an_aperture() {
    let lens = |more: Value| {
        let mut lens = json!({ "focus": 3, "blades": 5 });
        for (key, value) in more.as_object().expect("members") {
            lens[key] = value.clone();
        }
        pixels(&with_lens(&lens), 0)
    };
    assert_eq!(lens(json!({ "aperture": 0.5 })), lens(json!({ "f_stop": 2, "focal_length": 1 })));
    assert_ne!(lens(json!({ "aperture": 0.5 })), lens(json!({ "f_stop": 4, "focal_length": 1 })));
}

#[test]
fn every_number_of_a_lens_moves() {
    let keys = |from: Value, to: Value| json!({ "keys": [[0, from], [2, to]] });
    let formula = |text: &str| json!({ "expr": text });
    let constant = json!({ "aperture": 0.4, "focus": 3, "blades": 6, "turn": 10 });
    let cases = [
        ("aperture", keys(json!(0.6), json!(0.2)), constant.clone()),
        ("aperture", formula("0.6 - 0.2 * t"), constant.clone()),
        ("focus", keys(json!(2), json!(4)), constant.clone()),
        ("focus", formula("2 + t"), constant.clone()),
        ("focus", keys(json!([0, 1, 4]), json!([0, 1, 2])), constant.clone()),
        ("focus", json!([0, 1, { "expr": "4 - t" }]), constant.clone()),
        ("focus", json!({ "path": { "through": [[0, 0, 5], [0, 0, 1]], "keys": [[0, 0], [2, 1]] } }), constant.clone()),
        ("turn", keys(json!(0), json!(20)), constant.clone()),
        ("f_stop", formula("1 + t"), json!({ "f_stop": 2, "focal_length": 0.8, "focus": 3, "blades": 6, "turn": 10 })),
        (
            "focal_length",
            keys(json!(0.4), json!(1.2)),
            json!({ "f_stop": 2, "focal_length": 0.8, "focus": 3, "blades": 6, "turn": 10 }),
        ),
    ];
    for (key, motion, constant) in cases {
        let mut lens = constant.clone();
        lens[key] = motion;
        let moving = job(&json!({ "lens": lens }), &[[0.0; 3]], 3);
        assert!(moving.is_animated(), "{lens}");
        let frames = [0, 1, 2].map(|frame| pixels(&moving, frame));
        assert!(frames[0] != frames[1] && frames[1] != frames[2], "{lens}");
        // The seed of a frame is its number.
        assert_eq!(frames[1], pixels(&job(&json!({ "lens": constant }), &[[0.0; 3]], 3), 1), "{lens}");
    }
}

#[test]
fn an_aperture_may_close_in_a_frame() {
    let lens = json!({ "aperture": { "keys": [[0, 0.4], [1, 0], [2, 0.4]] }, "focus": 3 });
    let moving = job(&json!({ "lens": lens }), &[[0.0; 3]], 3);
    let (closed, pinhole) = (pixels(&moving, 1), pixels(&job(&json!({}), &[[0.0; 3]], 3), 1));
    let differing = closed.iter().zip(&pinhole).filter(|(one, other)| one != other).count();
    assert!(differing < 8, "{differing} pixels differ by more than rounding");
}

#[test]
fn a_group_places_the_lens_and_its_focus() {
    let lens = json!({ "aperture": 0.5, "focus": [0.3, 0.1, 1], "blades": 5 });
    let camera = json!({ "position": [0, 0, 6], "look_at": [0, 0, 0], "lens": lens });
    let text = |groups: Value| {
        json!({ "scene": { "camera": camera, "groups": groups, "objects": [{ "shape": { "sphere": { "radius": 1 } } }] },
            "image": { "width": SIZE, "height": SIZE } })
        .to_string()
    };
    let job = |groups: Value| scene::parse(text(groups).as_bytes()).expect("a job");
    let ray = |job: &Job| {
        let at_frame = job.at(0).expect("a frame");
        let ray = at_frame.scene().camera.view(SIZE, SIZE).ray_through_lens(5.0_f32, 9.0, || (0.2, 0.7));
        (ray.origin, ray.direction)
    };
    let (origin, direction) = ray(&job(json!([])));
    let (placed_origin, placed_direction) =
        ray(&job(json!([{ "by": [1, 2, 3], "degrees": 90, "axis": [0, 1, 0], "camera": true }])));
    let rotated = |v: Vec3<f32>| vec3(v.z, v.y, -v.x);
    assert!((rotated(origin) + vec3(1.0, 2.0, 3.0) - placed_origin).length() < 1e-5);
    assert!((rotated(direction) - placed_direction).length() < 1e-6);
}

#[test]
fn a_tile_of_a_region_has_the_rays_of_the_whole_picture() {
    let mut text = json!({
        "scene": { "camera": { "position": [0, 0, 6], "look_at": [0, 0, 0], "lens": { "aperture": 1, "focus": 3 } },
            "objects": [{ "shape": { "sphere": { "radius": 1 } } }] },
        "image": { "width": SIZE, "height": SIZE, "samples": 3 } });
    let whole = pixels(&scene::parse(text.to_string().as_bytes()).expect("a job"), 0);
    text["image"]["region"] = json!([7, 5, 9, 11]);
    let region = scene::parse(text.to_string().as_bytes()).expect("a job");
    let at_frame = region.at(0).expect("a frame");
    let part = Integrator::new(&at_frame).pixel(2.0_f32, 3.0);
    let index = ((5 + 3) * SIZE + 7 + 2) as usize;
    assert_eq!([part.color.x, part.color.y, part.color.z, part.alpha].map(f32::to_bits), whole[index]);
}

#[test]
fn the_layers_are_those_of_a_pinhole() {
    let (lens, pinhole) = (with_lens(&json!({ "aperture": 1, "focus": 3 })), job(&json!({}), &[[0.0; 3]], 1));
    let of = |job: &Job| {
        let at_frame = job.at(0).expect("a frame");
        let seen = Integrator::new(&at_frame).layer_values(12.0_f32, 10.0);
        (seen.depth, seen.normal, seen.object)
    };
    let ((depth, normal, object), (pinhole_depth, pinhole_normal, pinhole_object)) = (of(&lens), of(&pinhole));
    assert!((depth - pinhole_depth).abs() < 1e-5 && (normal - pinhole_normal).length() < 1e-4);
    assert_eq!(object, pinhole_object);
}

#[test]
fn an_object_that_only_the_blur_brings_into_the_picture_is_no_mistake() {
    let beside = [[0.0, 2.6, 0.0]];
    let pinhole = job(&json!({}), &beside, 1);
    assert!(scene::warnings(&pinhole)[0].contains("outside the view"), "{:?}", scene::warnings(&pinhole));
    let lens = job(&json!({ "lens": { "aperture": 2, "focus": 2 } }), &beside, 1);
    assert_eq!(scene::warnings(&lens), [""; 0]);
    assert!(pixels(&lens, 0).iter().any(|pixel| pixel[0] != 0), "it is seen");
    let narrow = job(&json!({ "lens": { "aperture": 0.1, "focus": 2 } }), &beside, 1);
    assert!(scene::warnings(&narrow)[0].contains("outside the view"), "{:?}", scene::warnings(&narrow));
}

#[test]
fn a_lens_that_reaches_into_an_object_is_reported() {
    let near = [[0.0; 3], [0.0, 0.7, 6.0]];
    let of = |aperture: f32| scene::warnings(&job(&json!({ "lens": { "aperture": aperture, "focus": 5 } }), &near, 1));
    assert_eq!(of(0.1), [""; 0]);
    let reported = of(0.6);
    assert!(reported.len() == 1 && reported[0].contains("part of the lens is inside object 1"), "{reported:?}");
}

#[test]
fn many_samples_of_a_lens_are_no_waste() {
    let of = |camera: Value| {
        let mut job = job(&camera, &[[0.0; 3]], 1);
        job.image.samples = 1024.into();
        scene::warnings(&job)
    };
    assert!(of(json!({}))[0].contains("samples"));
    assert_eq!(of(json!({ "lens": { "aperture": 0.3, "focus": 3 } })), [""; 0]);
}
