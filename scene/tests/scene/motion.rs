//! The layer `motion`: ways in the picture until the next frame, compared with points that are projected in `f64`.

#![expect(clippy::disallowed_methods, reason = "the reference must not use the code under test")]

use scene::cells::ScalarBuilder;
use scene::{Integrator, Job};
use serde_json::{Value, json};

const WIDTH: u32 = 48;
const HEIGHT: u32 = 36;

type Point = [f64; 3];

fn job_in(width: u32, camera: &Value, objects: &Value, frames: u32) -> Job {
    let text = json!({ "scene": { "camera": camera, "objects": objects },
        "image": { "width": width, "height": HEIGHT, "format": "exr", "layers": ["motion"] },
        "frames": { "count": frames, "fps": 2 } });
    scene::parse(text.to_string().as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}\n{text}"))
}

fn job(camera: &Value, objects: &Value) -> Job {
    job_in(WIDTH, camera, objects, 3)
}

/// A number that changes by `step` a frame, from `start` in frame 0.
fn steps(start: f64, step: f64) -> Value {
    json!({ "keys": [[0, start], [2, start + 4.0 * step]] })
}

fn minus(a: Point, b: Point) -> Point {
    [0, 1, 2].map(|axis| a[axis] - b[axis])
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Point, b: Point) -> Point {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: Point) -> Point {
    a.map(|c| c / dot(a, a).sqrt())
}

/// A camera in one frame.
#[derive(Clone, Copy)]
struct Eye {
    position: Point,
    look_at: Point,
    fov: f64,
}

/// Right, up and distance ahead of an offset, for the camera's direction.
fn in_axes(eye: Eye, offset: Point) -> Point {
    let forward = unit(minus(eye.look_at, eye.position));
    let right = unit(cross(forward, [0.0, 1.0, 0.0]));
    [dot(offset, right), dot(offset, cross(right, forward)), dot(offset, forward)]
}

/// Place in the picture of an offset from a pinhole, in pixels to the right and up.
fn perspective(eye: Eye, offset: Point) -> [f64; 2] {
    let [right, up, ahead] = in_axes(eye, offset);
    let per_pixel = (eye.fov / 2.0).to_radians().tan() / (f64::from(HEIGHT) / 2.0);
    [right, up].map(|c| c / ahead / per_pixel)
}

/// The same in a panorama that is twice as wide as high.
fn panorama(eye: Eye, offset: Point) -> [f64; 2] {
    let [right, up, ahead] = in_axes(eye, offset);
    let radians = std::f64::consts::PI / f64::from(HEIGHT);
    [right.atan2(ahead) / radians, up.atan2(right.hypot(ahead)) / radians]
}

/// Compares the layer in frame 1 with the ways of points that `carry` takes to the next frame, and of the background.
/// Returns the number of pixels with a surface.
fn compare(
    job: &Job,
    eyes: [Eye; 2],
    project: fn(Eye, Point) -> [f64; 2],
    carry: impl Fn(Point, f32) -> Point,
) -> usize {
    let at_frame = job.at(1).expect("a valid frame");
    let integrator = Integrator::new(&at_frame);
    let mut hits = 0;
    for (x, y) in (0..job.image.height).flat_map(|y| (0..job.image.width).map(move |x| (x, y))) {
        let seen = integrator.layer_values(x as f32, y as f32);
        let places = if seen.depth.is_finite() {
            hits += 1;
            let p = <[f32; 3]>::from(seen.position).map(f64::from);
            let next = carry(p, seen.object);
            [project(eyes[0], minus(p, eyes[0].position)), project(eyes[1], minus(next, eyes[1].position))]
        } else {
            let ray = integrator_ray(job, x, y);
            eyes.map(|eye| project(eye, ray))
        };
        let want = [places[1][0] - places[0][0], places[1][1] - places[0][1]];
        // The left and the right edge of a panorama are one.
        let around = |way: f64| way - (way / (2.0 * f64::from(HEIGHT))).round() * 2.0 * f64::from(HEIGHT);
        let wraps = job.image.width == 2 * HEIGHT;
        let want = [if wraps { around(want[0]) } else { want[0] }, want[1]];
        let got = <[f32; 2]>::from(seen.motion).map(f64::from);
        let off = (got[0] - want[0]).abs().max((got[1] - want[1]).abs());
        assert!(off < 1e-3, "({x}, {y}): {got:?}, not {want:?}");
    }
    hits
}

/// Direction through a pixel's center in frame 1.
fn integrator_ray(job: &Job, x: u32, y: u32) -> Point {
    let at_frame = job.at(1).expect("a valid frame");
    let view = at_frame.scene().camera.view(job.image.width, job.image.height);
    <[f32; 3]>::from(view.ray(x as f32 + 0.5, y as f32 + 0.5).direction).map(f64::from)
}

const EYE: Eye = Eye { position: [0.5, 1.0, 5.0], look_at: [0.0, 0.2, 0.0], fov: 40.0 };

fn camera() -> Value {
    json!({ "position": [0.5, 1, 5], "look_at": [0, 0.2, 0] })
}

#[test]
fn a_sphere_moves_by_its_offset() {
    let moving = json!([{ "shape": { "translate": { "by": [steps(0.0, 0.2), steps(0.0, -0.1), steps(0.0, 0.3)],
        "child": { "sphere": { "radius": 1 } } } } }]);
    let hits = compare(&job(&camera(), &moving), [EYE, EYE], perspective, |[x, y, z], _| [x + 0.2, y - 0.1, z + 0.3]);
    assert!(hits > 200, "{hits}");
}

#[test]
fn motion_to_the_right_and_up_is_positive() {
    let camera =
        json!({ "position": [0, 0, 5], "look_at": [0, 0, 0], "projection": { "orthographic": { "height": 3.6 } } });
    let moving = json!([{ "shape": { "translate": { "by": [steps(0.0, 0.3), steps(0.0, 0.2), 0],
        "child": { "sphere": { "radius": 1 } } } } }]);
    let job = job(&camera, &moving);
    let at_frame = job.at(1).expect("a valid frame");
    // A pixel is 0.1 wide.
    let (x, y) = Integrator::new(&at_frame).layer_values(24.0_f32, 18.0).motion;
    assert!((x - 3.0).abs() < 1e-4 && (y - 2.0).abs() < 1e-4, "({x}, {y})");
}

#[test]
fn a_box_turns_about_an_axis() {
    let turning = json!([{ "shape": { "rotate": { "degrees": steps(0.0, 20.0), "axis": [0, 1, 0], "about": [0.3, 0, 0],
        "child": { "box": { "size": [2, 1, 1] } } } } }]);
    let (sin, cos) = 20.0_f64.to_radians().sin_cos();
    let hits = compare(&job(&camera(), &turning), [EYE, EYE], perspective, |[x, y, z], _| {
        [(x - 0.3) * cos + z * sin + 0.3, y, z * cos - (x - 0.3) * sin]
    });
    assert!(hits > 200, "{hits}");
}

#[test]
fn a_camera_pans_moves_and_zooms() {
    let floor = json!([{ "shape": { "sphere": { "radius": 1 } } }, { "shape": { "plane": { "normal": [0, 1, 0], "offset": -1 } } }]);
    let fixed = |p: Point, _: f32| p;
    let pan = json!({ "position": [0.5, 1, 5], "look_at": [steps(-0.3, 0.3), 0.2, 0] });
    let next = Eye { look_at: [0.3, 0.2, 0.0], ..EYE };
    assert!(compare(&job(&pan, &floor), [EYE, next], perspective, fixed) > 900);
    let truck = json!({ "position": [steps(0.4, 0.1), 1, steps(5.2, -0.2)], "look_at": [0, 0.2, 0] });
    let next = Eye { position: [0.6, 1.0, 4.8], ..EYE };
    assert!(compare(&job(&truck, &floor), [EYE, next], perspective, fixed) > 900);
    let zoom = json!({ "position": [0.5, 1, 5], "look_at": [0, 0.2, 0], "fov": steps(38.0, 2.0) });
    assert!(compare(&job(&zoom, &floor), [EYE, Eye { fov: 42.0, ..EYE }], perspective, fixed) > 900);
    let turntable = json!({ "position": [0, 0, 5], "look_at": [0, 0, 0], "turntable": { "turns": 0.25 } });
    let at = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        Eye { position: [5.0 * sin, 0.0, 5.0 * cos], look_at: [0.0; 3], fov: 40.0 }
    };
    assert!(compare(&job(&turntable, &floor), [at(30.0), at(60.0)], perspective, fixed) > 900);
}

#[test]
fn a_panorama_wraps_around() {
    let panning =
        json!({ "position": [0, 0, steps(0.0, 0.1)], "look_at": [steps(-2.0, 2.0), 0, -4], "projection": "panorama" });
    let objects = json!([{ "shape": { "translate": { "by": [0.5, steps(0.0, 0.2), 4], "child": { "sphere": { "radius": 2 } } } } }]);
    let at = |x: f64, z: f64| Eye { position: [0.0, 0.0, z], look_at: [x, 0.0, -4.0], fov: 0.0 };
    let job = job_in(2 * HEIGHT, &panning, &objects, 3);
    let hits = compare(&job, [at(0.0, 0.1), at(2.0, 0.2)], panorama, |[x, y, z], _| [x, y + 0.2, z]);
    assert!(hits > 50, "{hits}");
}

#[test]
fn parallel_rays_show_a_background_that_stands_still() {
    let camera = json!({ "position": [steps(-0.2, 0.2), 1, 5], "look_at": [steps(-0.2, 0.2), 1, 0],
        "projection": { "orthographic": { "height": 3.6 } } });
    let job = job(
        &camera,
        &json!([{ "shape": { "translate": { "by": [0, 1, 0], "child": { "sphere": { "radius": 1 } } } } }]),
    );
    let at_frame = job.at(1).expect("a valid frame");
    let integrator = Integrator::new(&at_frame);
    assert_eq!(integrator.layer_values(0.0_f32, 0.0).motion, (0.0, 0.0));
    let (x, y) = integrator.layer_values(24.0_f32, 18.0).motion;
    assert!((x + 2.0).abs() < 1e-4 && y.abs() < 1e-4, "({x}, {y})");
}

/// Motion through groups and copies, to a part that a moving shape cuts.
#[test]
fn parts_move_with_all_that_is_around_them() {
    let hole = json!({ "translate": { "by": [0, steps(0.0, 0.1), 0.5], "child": { "sphere": { "radius": 0.45 } } } });
    let cut = json!({ "difference": { "of": [{ "box": { "size": [1, 1, 1] } }, hole] } });
    let row = json!({ "repeat": { "cell": [1.5, null, null], "count": [3, null, null], "child": cut } });
    let text = json!({
        "scene": { "camera": camera(), "objects": [{ "shape": { "translate": { "by": [0, -90, 0], "child": { "sphere": { "radius": 1 } } } } }],
            "groups": [{ "by": [steps(0.0, 0.3), 0, 0], "objects": [{ "shape": row }] }] },
        "image": { "width": WIDTH, "height": HEIGHT, "format": "exr", "layers": ["motion"] },
        "frames": { "count": 3, "fps": 2 } });
    let job = scene::parse(text.to_string().as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}"));
    let mut holes = 0;
    let seen_holes = std::cell::RefCell::new(&mut holes);
    let hits = compare(&job, [EYE, EYE], perspective, |[x, y, z], _| {
        // In frame 1 the row is at 0.3, and the hole 0.1 above the middle.
        let x_in_cell = (x - 0.3) - 1.5 * ((x - 0.3) / 1.5).round();
        let from_hole = (x_in_cell * x_in_cell + (y - 0.1) * (y - 0.1) + (z - 0.5) * (z - 0.5)).sqrt();
        let is_hole = (from_hole - 0.45).abs() < 1e-4;
        **seen_holes.borrow_mut() += usize::from(is_hole);
        [x + 0.3, y + if is_hole { 0.1 } else { 0.0 }, z]
    });
    assert!(hits > 200 && holes > 30, "{hits}, {holes} in holes");
}

#[test]
fn the_last_frame_moves_on_and_a_frame_alone_moves() {
    let moving = json!([{ "shape": { "translate": { "by": [steps(0.0, 0.2), 0, 0], "child": { "sphere": { "radius": 1 } } } } }]);
    for frames in [1, 2] {
        let job = job_in(WIDTH, &camera(), &moving, frames);
        let at_frame = job.at(frames - 1).expect("a valid frame");
        let (x, _) = Integrator::new(&at_frame).layer_values(24.0_f32, 18.0).motion;
        assert!(x > 1.0, "frame {} of {frames}: {x}", frames - 1);
        assert_eq!(scene::warnings(&job), Vec::<String>::new());
    }
}

#[test]
fn nothing_moves_where_nothing_is_animated() {
    let objects = json!([{ "shape": { "sphere": { "radius": 1 } } }, { "shape": { "translate": { "by": [0, steps(8.0, 0.1), 0],
        "child": { "sphere": { "radius": 1 } } } } }]);
    let job = job(&camera(), &objects);
    let at_frame = job.at(1).expect("a valid frame");
    let integrator = Integrator::new(&at_frame);
    for (x, y) in [(24.0_f32, 18.0), (0.0, 0.0), (47.0, 30.0)] {
        assert_eq!(integrator.layer_values(x, y).motion, (0.0, 0.0));
    }
    let without = job_in(WIDTH, &camera(), &json!([{ "shape": { "sphere": { "radius": 1 } } }]), 1);
    assert!(scene::warnings(&without)[0].contains("motion is 0 everywhere"), "{:?}", scene::warnings(&without));
    let at_frame = without.at(0).expect("a valid frame");
    assert_eq!(Integrator::new(&at_frame).layer_values(24.0_f32, 18.0).motion, (0.0, 0.0));
}

#[test]
fn an_invalid_frame_after_the_last_is_an_error_that_names_it() {
    let camera = json!({ "position": [0, 0, { "keys": [[0, 4], [1, 0]] }], "look_at": [0, 0, 0] });
    let text = |layers: Value| {
        json!({ "scene": { "camera": camera, "objects": [{ "shape": { "sphere": { "radius": 1 } } }] },
            "image": { "width": 8, "height": 8, "format": "exr", "layers": layers },
            "frames": { "count": 2, "fps": 2 } })
        .to_string()
    };
    assert!(scene::parse(text(json!([])).as_bytes()).is_ok());
    let refusal = scene::parse(text(json!(["motion"])).as_bytes()).expect_err("frame 2 is invalid").to_string();
    assert!(refusal.contains("in frame 2, at 1 seconds") && refusal.contains("/scene/camera/look_at"), "{refusal}");
}

#[test]
fn keys_depend_on_the_next_frame_with_the_layer_alone() {
    let keys = |last: f64, layers: Value| {
        let track = json!({ "keys": [[0, 0], [1, 1], [2, last]] });
        let text = json!({ "scene": { "camera": camera(), "objects": [{ "shape": { "translate": { "by": [track, 0, 0],
            "child": { "sphere": { "radius": 1 } } } } }] },
            "image": { "width": 8, "height": 8, "format": "exr", "layers": layers }, "frames": { "count": 3, "fps": 1 } });
        let job = scene::parse(text.to_string().as_bytes()).expect("a valid job");
        [0, 1].map(|frame| {
            let at_frame = job.at(frame).expect("a valid frame");
            (at_frame.cache_key(), at_frame.pixels_cache_key(), at_frame.scene_hash())
        })
    };
    let (with, without) = (|last| keys(last, json!(["motion"])), |last| keys(last, json!(["depth"])));
    assert_eq!(without(2.0), without(3.0));
    assert_eq!(with(2.0)[0], with(3.0)[0]);
    let ([_, one], [_, other]) = (with(2.0), with(3.0));
    assert!(one.0 != other.0 && one.1 != other.1 && one.2 != other.2, "frame 1 shows the way to frame 2");
}

/// Moving rows of many shapes, some of them painted, are rendered by cells.
#[test]
fn cells_give_the_same_motion() {
    let ball = |index: u32| {
        let (x, z) = (f64::from(index % 12) * 0.5 - 3.0, f64::from(index / 12) * 0.5 - 3.0);
        let ball = json!({ "translate": { "by": [x, steps(0.0, 0.02 * f64::from(index % 5)), z], "child": { "sphere": { "radius": 0.2 } } } });
        if index.is_multiple_of(3) {
            json!({ "paint": { "material": { "flat": { "color": [1, 0, 0] } }, "child": ball } })
        } else {
            ball
        }
    };
    let union = json!({ "union": { "smooth": 0.1, "of": (0..140).map(ball).collect::<Vec<_>>() } });
    let copies = json!({ "copies": { "at": { "ring": 8, "radius": 2 }, "child": { "union": { "of": [
        { "translate": { "by": [0, 1, steps(0.0, 0.05)], "child": { "sphere": { "radius": 0.3 } } } },
        { "translate": { "by": [0, 1.4, 0], "child": { "sphere": { "radius": 0.2 } } } }] } } } });
    let objects = json!([
        { "shape": { "rotate": { "degrees": [0, steps(0.0, 4.0), 0], "child": union } } },
        { "shape": { "rotate": { "degrees": [0, steps(0.0, -9.0), 0], "child": copies } } },
        { "shape": { "plane": { "normal": [0, 1, 0], "offset": -0.4 } } }]);
    let camera = json!({ "position": [0, 3, steps(7.0, -0.2)], "look_at": [0, 0, 0] });
    let job = job(&camera, &objects);
    let at_frame = job.at(1).expect("a valid frame");
    let (by_cells, without) = (Integrator::of_picture(&at_frame, &ScalarBuilder), Integrator::new(&at_frame));
    assert!(by_cells.table().is_some(), "the scene is rendered by cells");
    let mut moved = 0;
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x as f32, y as f32))) {
        let (got, want) = (by_cells.layer_values(x, y), without.layer_values(x, y));
        if (got.depth / want.depth - 1.0).abs() > 1e-4 {
            continue;
        }
        let [got, want] = [got, want].map(|seen| <[f32; 2]>::from(seen.motion));
        let off = (got[0] - want[0]).abs().max((got[1] - want[1]).abs());
        assert!(off < 2e-2, "({x}, {y}): {got:?} by cells, not {want:?}");
        moved += usize::from(want[0].abs() > 0.1);
    }
    assert!(moved > 300, "{moved} pixels move");
}
