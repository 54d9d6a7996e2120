//! `scatter`: placements follow from the seed alone, keep their distances, and are on the surface; and its errors.

use scene::nodes::Node;
use scene::real::{Vec3, vec3};
use scene::{Job, ParseError, ValidationError};
use serde_json::{Value, json};

fn job_of(shapes: &Value, shape: &Value) -> Result<Job, ParseError> {
    let job = json!({
        "scene": { "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] }, "shapes": shapes, "objects": [{ "shape": shape }] },
        "image": { "width": 8, "height": 8 }, "frames": { "count": 3, "fps": 1 }
    });
    scene::parse(job.to_string().as_bytes())
}

fn job(shape: &Value) -> Job {
    job_of(&json!({}), shape).unwrap_or_else(|refusal| panic!("{refusal}\n{shape}"))
}

fn shape(value: &Value) -> Node {
    job(value).scene.objects[0].shape.clone()
}

/// A scatter of balls of radius 0.01 with other numbers replaced.
fn scatter(changes: &Value) -> Value {
    let mut scatter = json!({
        "of": [{ "sphere": { "radius": 0.01 } }], "count": 40, "within": { "disc": { "radius": 1 } }, "apart": 0.1
    });
    for (key, value) in changes.as_object().unwrap() {
        scatter[key] = value.clone();
    }
    json!({ "scatter": scatter })
}

/// Centers of the balls of radius 0.01 in a box: the cells of a fine grid from which steps along the distance end in one.
fn centers(node: &Node, half: Vec3<f32>) -> Vec<Vec3<f32>> {
    let (mut found, cells): (Vec<Vec3<f32>>, i32) = (Vec::new(), 40);
    let flat = half.y == 0.0;
    for (x, y, z) in
        (-cells..=cells).flat_map(|x| (-cells..=cells).flat_map(move |y| (-cells..=cells).map(move |z| (x, y, z))))
    {
        if flat && y != 0 {
            continue;
        }
        let step = |c: i32, half: f32| c as f32 * half / cells as f32;
        let mut p = vec3(step(x, half.x), step(y, half.y), step(z, half.z));
        if node.distance(p) > 0.1 {
            // The grid has points that are nearer to each ball.
            continue;
        }
        for _ in 0..4 {
            let d = node.distance(p) + 0.01;
            let slope = |by: Vec3<f32>| (node.distance(p + by) - node.distance(p - by)) / 2e-3;
            let gradient = vec3(slope(vec3(1e-3, 0.0, 0.0)), slope(vec3(0.0, 1e-3, 0.0)), slope(vec3(0.0, 0.0, 1e-3)));
            p = gradient.mul_add(-d, p);
        }
        if node.distance(p) < -0.009 && found.iter().all(|other| (*other - p).length() > 5e-3) {
            found.push(p);
        }
    }
    found
}

#[test]
fn copies_keep_their_distance_and_stay_in_the_region() {
    let node = shape(&scatter(&json!({})));
    let found = centers(&node, vec3(1.0, 0.0, 1.0));
    assert_eq!(found.len(), 40);
    for (index, p) in found.iter().enumerate() {
        assert!(p.x * p.x + p.z * p.z <= 1.001 && p.y.abs() < 2e-3, "{p:?}");
        for other in &found[index + 1..] {
            assert!((*other - *p).length() > 0.098, "{p:?} and {other:?}");
        }
    }
    let mean = found.iter().fold(vec3(0.0, 0.0, 0.0), |sum, p| sum + *p) * (1.0 / 40.0);
    assert!(mean.length() < 0.25, "{mean:?}");
}

#[test]
fn placements_follow_from_the_seed_alone() {
    let points = || (0..500).map(|index| vec3((index % 10) as f32 * 0.2 - 1.0, 0.1, (index / 10) as f32 * 0.04 - 1.0));
    let of = |changes: &Value| {
        let node = shape(&scatter(changes));
        points().map(|p| node.distance(p).to_bits()).collect::<Vec<_>>()
    };
    let first = of(&json!({}));
    assert_eq!(first, of(&json!({})));
    assert_eq!(first, of(&json!({ "seed": 0, "turn": 360, "scale": [1, 1], "smooth": 0 })));
    assert_ne!(first, of(&json!({ "seed": 1 })));
    // A witness against changes of the hash or of its use.
    let sum = first.iter().fold(0_u32, |sum, bits| sum.rotate_left(5) ^ bits);
    assert_eq!(sum, WITNESS, "{sum:#010x}");
}

const WITNESS: u32 = 0x5f56_88d3;

#[test]
fn every_number_changes_the_cache_key() {
    let changes = [
        json!({}),
        json!({ "count": 41 }),
        json!({ "seed": 1 }),
        json!({ "apart": 0.11 }),
        json!({ "turn": 90 }),
        json!({ "scale": [0.5, 1] }),
        json!({ "smooth": 0.1 }),
        json!({ "within": { "disc": { "radius": 1.1 } } }),
        json!({ "within": { "sphere": { "radius": 1 } } }),
        json!({ "within": { "box": { "size": [1, 1, 1] } } }),
        json!({ "on": { "sphere": { "radius": 3 } } }),
        json!({ "on": { "sphere": { "radius": 3.1 } } }),
    ];
    let keys: std::collections::HashSet<_> = changes.iter().map(|change| job(&scatter(change)).cache_key(0)).collect();
    assert_eq!(keys.len(), changes.len());
}

#[test]
fn copies_are_on_the_surface_and_upright() {
    let hills = json!({ "union": { "of": [
        { "plane": { "normal": [0, 1, 0], "offset": -0.5 } },
        { "translate": { "by": [0.2, 0, 0], "child": { "sphere": { "radius": 0.6 } } } }
    ] } });
    let on = serde_json::from_value::<Node>(hills.clone()).unwrap();
    // Each copy is a ball above its origin, far smaller than the distance to the others.
    let needle = json!({ "translate": { "by": [0, 0.2, 0], "child": { "sphere": { "radius": 0.01 } } } });
    let node = shape(&scatter(&json!({ "of": [needle], "on": hills, "count": 25 })));
    let found = centers(&node, vec3(1.0, 1.0, 1.0));
    assert_eq!(found.len(), 25);
    for p in &found {
        let foot = *p - vec3(0.0, 0.2, 0.0);
        assert!(on.distance(foot).abs() < 3e-3, "{foot:?} is {} from the surface", on.distance(foot));
    }
    assert!(found.iter().any(|p| p.y > 0.2), "some are on the ball");
}

#[test]
fn copies_are_on_terrain_however_steep() {
    for scale in [0.1, 1.0, 12.0] {
        let noise = json!({ "perlin": { "octaves": 4, "scale": scale } });
        let on = json!({ "height_field": { "noise": noise, "height": 2 } });
        let ground: Node = serde_json::from_value(on.clone()).unwrap();
        let mut heights = Vec::new();
        for seed in 0..40 {
            let one = json!({ "on": on, "count": 1, "seed": seed, "within": { "disc": { "radius": 20 } } });
            // The only ball is in the middle of its bounds.
            let bounds = shape(&scatter(&one)).bounds(0.0);
            let p = (bounds.min + bounds.max) * 0.5;
            assert!(ground.distance(p).abs() < 1e-3, "{} above the ground at {p:?}", ground.distance(p));
            heights.push(p.y);
        }
        heights.sort_by(f32::total_cmp);
        assert!(heights[39] - heights[0] > 0.3, "{heights:?}");
    }
}

#[test]
fn a_copy_that_meets_no_surface_is_tried_elsewhere() {
    let table = json!({ "box": { "size": [0.8, 0.1, 0.8] } });
    let node = shape(&scatter(&json!({ "on": table, "count": 12 })));
    let bounds = node.bounds(0.0);
    assert!(bounds.min.x > -0.42 && bounds.max.z < 0.42 && (bounds.max.y - 0.06).abs() < 1e-4, "{bounds:?}");
}

#[test]
fn the_surface_may_be_a_named_shape() {
    let shapes = json!({ "ground": { "sphere": { "radius": 0.7 } } });
    let named = job_of(&shapes, &scatter(&json!({ "on": { "use": "ground" }, "count": 5 }))).unwrap();
    let written = job(&scatter(&json!({ "on": shapes["ground"], "count": 5 })));
    assert_eq!(named.scene, written.scene);
    assert!(scene::warnings(&named).iter().all(|warning| !warning.contains("ground")), "{:?}", scene::warnings(&named));
}

#[test]
fn each_shape_is_used_and_scales_are_in_range() {
    let of = json!([{ "sphere": { "radius": 0.02 } }, { "box": { "size": [0.05, 0.3, 0.05] } }]);
    let node = shape(&scatter(&json!({ "of": of, "scale": [0.5, 1] })));
    let bounds = node.bounds(0.0);
    assert!(bounds.max.y > 0.1 && bounds.max.y <= 0.15, "{bounds:?}");
    let large = shape(&scatter(&json!({ "scale": [2, 2] })));
    assert!((large.bounds(0.0).max.y - 0.02).abs() < 1e-6);
}

#[test]
fn numbers_of_the_shapes_may_be_animated() {
    let of = json!([{ "sphere": { "radius": { "keys": [[0, 0.01], [2, 0.05]] } } }]);
    let job = job(&scatter(&json!({ "of": of })));
    let reach = |frame| job.at(frame).unwrap().scene().objects[0].shape.bounds(0.0).max.y;
    assert!((reach(0) - 0.01).abs() < 1e-6 && (reach(2) - 0.05).abs() < 1e-6);
}

#[track_caller]
fn has_fault(changes: &Value, pointer: &str, words: &str) {
    let Err(ParseError::Invalid(faults)) = job_of(&json!({}), &scatter(changes)) else { panic!("{changes} is valid") };
    let [ValidationError { pointer: at, message, .. }] = faults.as_slice() else { panic!("{faults:#?}") };
    assert!(*at == format!("/scene/objects/0/shape/scatter{pointer}") && message.contains(words), "{at}: {message}");
}

#[test]
fn errors_have_their_place_and_fix() {
    let animated = json!({ "sphere": { "radius": { "keys": [[0, 1], [1, 2]] } } });
    let many: Vec<Value> =
        (0..200).map(|index| json!({ "sphere": { "radius": 1.0 + f64::from(index) * 1e-3 } })).collect();
    for (changes, pointer, words) in [
        (json!({ "count": 1_000_000_000 }), "/count", "must be 1 to 1000000 copies"),
        (json!({ "count": 1_000_000 }), "", "use fewer copies"),
        (json!({ "of": [] }), "/of", "needs a shape or more"),
        (json!({ "apart": 0.9 }), "/count", "copies fit: lower \"count\" or \"apart\""),
        (
            json!({ "on": { "translate": { "by": [9, 0, 0], "child": { "sphere": { "radius": 1 } } } } }),
            "/count",
            "only 0 copies fit",
        ),
        (json!({ "on": animated }), "/on", "write numbers instead of tracks"),
        (json!({ "on": { "torus": { "radius": 1, "tube": 2 } } }), "/on/torus/tube", "less than 1"),
        (json!({ "on": { "use": "ground" } }), "/on/use", "is not in /scene/shapes"),
        (json!({ "on": { "ball": { "radius": 1 } } }), "/on/ball", "did you mean `sphere`?"),
        (json!({ "on": { "union": { "of": many } }, "count": 90_000 }), "/on", "use fewer copies, or a simpler shape"),
        (json!({ "scale": [1.2, 0.5] }), "/scale/0", "[minimum, maximum]"),
        (json!({ "scale": 1.2 }), "/scale", "a list of 2"),
        (json!({ "turn": { "keys": [[0, 1]] } }), "/turn", "cannot be a track"),
        (json!({ "seed": -1 }), "/seed", "0 to 4294967295"),
        (json!({ "within": { "disk": { "radius": 1 } } }), "/within/disk", "did you mean `disc`?"),
        (json!({ "within": { "box": { "size": [1, -1, 1] } } }), "/within/box/size/1", "0, or a size"),
    ] {
        has_fault(&changes, pointer, words);
    }
}
