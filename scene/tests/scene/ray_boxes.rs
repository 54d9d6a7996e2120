//! Large objects are evaluated only where a ray is in their boxes: it meets the same surfaces as if they were small.

use scene::Integrator;
use scene::real::Vec3;
use serde_json::{Value, json};

const SIZE: u32 = 48;

/// The point that a pixel's ray meets.
struct Met {
    depth: f32,
    normal: Vec3<f32>,
    steps: f32,
}

/// Heaps of balls before and behind each other, partly in each other's boxes, on a floor, with a pane of glass, so that marches run on both sides: a heap is one
/// object of many nodes, or each ball is an object.
fn heaps(are_large: bool, camera: &Value) -> Vec<Met> {
    let mut word = 3_u32;
    let mut random = || {
        word = word.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        f64::from(word >> 8) / f64::from(1 << 24)
    };
    let mut objects = vec![
        json!({ "material": "gray", "shape": { "plane": { "normal": [0, 1, 0], "offset": -1.2 } } }),
        json!({ "material": "glass", "shape": { "translate": { "by": [0.4, -0.2, 2.2], "child": { "box": { "size": [1.2, 1.2, 0.4] } } } } }),
    ];
    for center in [[-1.6, 0.0, 0.5], [0.9, 0.2, 0.0], [0.4, -0.3, -1.0], [0.0, 0.6, -3.0]] {
        let mut ball = || {
            let at = center.map(|along| along + 1.6 * (random() - 0.5));
            json!({ "translate": { "by": at, "child": { "sphere": { "radius": 0.05 + 0.2 * random() } } } })
        };
        let balls: Vec<Value> = (0..24).map(|_| ball()).collect();
        let object = |shape: Value| json!({ "material": "gray", "shape": shape });
        if are_large {
            // Of one part.
            let far = json!({ "translate": { "by": [0, 90, 0], "child": { "sphere": { "radius": 1 } } } });
            objects.push(object(json!({ "difference": { "of": [{ "union": { "of": balls } }, far] } })));
        } else {
            objects.extend(balls.into_iter().map(object));
        }
    }
    let text = json!({
        "scene": { "camera": camera, "objects": objects, "materials": {
            "gray": { "diffuse": { "kd": [0.5, 0.5, 0.5] } },
            "glass": { "surface": { "roughness": 0, "transmission": 1 } } } },
        "image": { "width": SIZE, "height": SIZE, "samples": 1 } })
    .to_string();
    let job = scene::parse(text.as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}\n{text}"));
    let at_frame = job.at(0).expect("a frame");
    let integrator = Integrator::new(&at_frame);
    let met = |index: u32| {
        let seen = integrator.layer_values((index % SIZE) as f32, (index / SIZE) as f32);
        Met { depth: seen.depth, normal: seen.normal, steps: seen.steps }
    };
    (0..SIZE * SIZE).map(met).collect()
}

#[test]
fn rays_meet_large_objects_where_they_meet_small_ones() {
    for camera in [
        json!({ "position": [0, 0.6, 6], "look_at": [0, 0, 0], "fov": 40 }),
        // In a box; from far away.
        json!({ "position": [-1.6, 0.9, 0.5], "look_at": [1, 0, -1], "fov": 70 }),
        json!({ "position": [45, 20, 70], "look_at": [0, 0, 0], "fov": 4 }),
    ] {
        let (large, small) = (heaps(true, &camera), heaps(false, &camera));
        let (mut differ, mut steps) = (0, [0.0, 0.0]);
        for (one, other) in large.iter().zip(&small) {
            let is_same = one.depth == other.depth
                || ((one.depth - other.depth).abs() < 1e-3 * other.depth
                    && (one.normal - other.normal).length() < 0.05);
            differ += u32::from(!is_same);
            steps = [steps[0] + one.steps, steps[1] + other.steps];
        }
        // At silhouettes, a march may end on either side.
        assert!(differ <= SIZE * SIZE / 200, "{differ} pixels differ, seen from {camera}");
        assert!(steps[0] != steps[1], "large objects have boxes");
    }
}
