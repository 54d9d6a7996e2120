//! A carried point keeps its place in its shape's own space: that of a texture that is painted inside all transforms.

use scene::nodes::{DistanceWithMaterials, Node};
use scene::parse;
use scene::real::{Real, Vec3, vec3};
use serde_json::{Value, json};

/// A number that is `now` in frame 0 and `next` in frame 1.
fn from_to(now: impl Into<f64>, next: impl Into<f64>) -> Value {
    let (now, next): (f64, f64) = (now.into(), next.into());
    json!({ "keys": [[0, now], [1, next]] })
}

fn leaf() -> Value {
    let textured = json!({ "diffuse": { "kd": { "checker": { "cell": 0.3, "colors": [[1, 0, 0], [0, 1, 0]] } } } });
    json!({ "paint": { "material": textured, "child": { "box": { "size": [0.5, 0.9, 0.4], "round": 0.05 } } } })
}

/// The leaf, moved away from the origin and upward over time.
fn rising() -> Value {
    json!({ "translate": { "by": [0.7, from_to(0.1, 0.25), 0.2], "child": leaf() } })
}

/// The leaf, moved away from the origin.
fn beside() -> Value {
    json!({ "translate": { "by": [0.7, 0.1, 0.2], "child": leaf() } })
}

fn carrying_shapes() -> Vec<Value> {
    let both = || json!([rising(), { "translate": { "by": [-0.6, 0, from_to(0, 0.2)], "child": leaf() } }]);
    vec![
        rising(),
        json!({ "rotate": { "degrees": [from_to(10, 25), 20, from_to(0, -15)], "child": rising() } }),
        json!({ "rotate": { "degrees": from_to(10, 40), "axis": [1, 2, 0], "about": [from_to(0.5, 0.6), 0, 1], "child": rising() } }),
        json!({ "aim": { "at": [from_to(1, 0.6), 0.5, 1], "child": rising() } }),
        json!({ "scale": { "by": from_to(1, 1.3), "child": rising() } }),
        json!({ "stretch": { "by": [from_to(1, 1.3), 0.8, from_to(1, 0.7)], "child": rising() } }),
        json!({ "mirror": { "normal": [1, from_to(0, 0.2), 0], "offset": from_to(0, 0.1), "child": rising() } }),
        json!({ "mirror": { "normal": [1, 0.3, 0], "child": rising() } }),
        json!({ "mirror": { "normal": [1, 0.3, 0], "offset": from_to(0, 0.1), "child": beside() } }),
        json!({ "repeat": { "cell": [from_to(1.6, 1.9), null, 1.5], "count": [2, null, 3], "child": rising() } }),
        json!({ "repeat": { "cell": [from_to(1.6, 1.9), null, 1.5], "child": beside() } }),
        json!({ "polar_repeat": { "count": 4, "child": rising() } }),
        json!({ "twist": { "degrees_per_unit": from_to(20, 45), "child": rising() } }),
        json!({ "twist": { "degrees_per_unit": 20, "child": rising() } }),
        json!({ "bend": { "degrees_per_unit": from_to(20, 35), "child": rising() } }),
        json!({ "bend": { "degrees_per_unit": from_to(-5, -20), "child": beside() } }),
        json!({ "taper": { "bottom": -1, "top": from_to(1, 1.2), "top_factor": from_to(0.5, 0.8), "child": rising() } }),
        json!({ "copies": { "child": rising(), "at": [{ "by": [-1, 0, 0] },
            { "by": [1, 0.2, 0], "degrees": [0, 40, 70], "scale": 1.4 }] } }),
        json!({ "scatter": { "of": [rising(), leaf()], "count": 5, "within": { "disc": { "radius": 2 } }, "apart": 1.4 } }),
        json!({ "union": { "of": both() } }),
        json!({ "xor": { "of": both() } }),
        json!({ "intersection": { "of": [rising(), { "sphere": { "radius": 9 } }] } }),
        json!({ "rotate": { "degrees": [0, from_to(0, 20), 0], "child": { "union": { "of": [
            { "scale": { "by": from_to(1, 1.2), "child": rising() } },
            { "translate": { "by": [-1.2, 0, 0], "child": { "rotate": { "degrees": [from_to(0, 30), 0, 0], "child": leaf() } } } }
        ] } } } }),
    ]
}

/// The point in the space of the texture with the greatest weight.
fn own_point(shape: &Node, p: Vec3<f32>) -> Vec3<f32> {
    let value: DistanceWithMaterials<f32> = shape.sample(p);
    let heaviest = value.weights().iter().max_by(|a, b| a.weight.total_cmp(&b.weight));
    heaviest.expect("all shapes are painted").point
}

/// Points on a surface, where rays toward the middle meet it.
fn surface_points(shape: &Node) -> Vec<Vec3<f32>> {
    let ray = |index: u16| {
        let index = f32::from(index);
        let wave = |speed: f32| Real::sin(index * speed);
        let start = vec3(wave(2.4), wave(1.7) * 0.7, Real::cos(index * 2.4)) * 4.0;
        let target = vec3(wave(0.9), wave(0.6) * 0.3, wave(1.3) * 0.7);
        let direction = (target - start).normalize();
        let (mut t, scale) = (0.0, 1.0 / shape.lipschitz());
        for _ in 0..2000 {
            let p = start + direction * t;
            let distance = shape.distance(p);
            if distance < 1e-6 {
                // A ray may start inside.
                return (distance > -1e-6).then_some(p);
            }
            t += distance * scale;
        }
        None
    };
    (0..160).filter_map(ray).collect()
}

#[test]
fn a_point_keeps_its_place_in_its_shape() {
    for shape in carrying_shapes() {
        let text = json!({
            "scene": { "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] }, "objects": [{ "shape": shape }] },
            "image": { "width": 8, "height": 8, "format": "exr", "layers": ["motion"] },
            "frames": { "count": 2, "fps": 1 },
        });
        let job = parse(text.to_string().as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}: {text}"));
        let at_frame = job.at(0).expect("a valid frame");
        let [now, next] =
            [at_frame.scene(), at_frame.next_scene().expect("the next one")].map(|scene| &scene.objects[0].shape);
        let points = surface_points(now);
        assert!(points.len() > 20, "{shape}: {} rays meet it", points.len());
        let mut longest: f32 = 0.0;
        for p in points {
            let way = now.carry(next, p).way().expect("something moves");
            let (before, after) = (own_point(now, p), own_point(next, p + way));
            assert!((before - after).length() < 2e-5, "{shape}: {before:?} at {p:?} goes by {way:?} to {after:?}");
            let distance = next.distance(p + way);
            assert!(distance.abs() < 2e-5, "{shape}: {p:?} leaves the surface by {way:?}, {distance} away");
            longest = longest.max(way.length());
            let at_frame = now.carry(now, p).way().expect("the same numbers are animated");
            assert_eq!(<[f32; 3]>::from(at_frame), [0.0; 3], "{shape}: nothing moves at {p:?}");
        }
        assert!(longest > 0.05, "{shape}: something moves");
    }
}

#[test]
fn the_way_across_a_smooth_seam_is_between_those_of_its_shapes() {
    let text = json!({
        "scene": { "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] }, "objects": [{ "shape": {
            "union": { "smooth": 0.5, "of": [{ "sphere": { "radius": 1 } },
                { "translate": { "by": [1, from_to(0, 0.5), 0], "child": { "sphere": { "radius": 1 } } } }] } } }] },
        "image": { "width": 8, "height": 8, "format": "exr", "layers": ["motion"] },
        "frames": { "count": 2, "fps": 1 },
    });
    let job = parse(text.to_string().as_bytes()).expect("a valid job");
    let at_frame = job.at(0).expect("a valid frame");
    let [now, next] =
        [at_frame.scene(), at_frame.next_scene().expect("the next one")].map(|scene| &scene.objects[0].shape);
    let way = |x: f32| now.carry(next, vec3(x, 1.0, 0.0)).way().expect("one moves").y;
    let ways: Vec<f32> = [-0.5, 0.3, 0.5, 0.7, 1.5].map(way).into();
    assert!(ways.is_sorted() && ways[1] > 0.0 && ways[3] < 0.5, "{ways:?}");
    assert_eq!((ways[0], ways[2], ways[4]), (0.0, 0.25, 0.5));
}
