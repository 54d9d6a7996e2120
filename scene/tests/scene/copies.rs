//! `copies`, compared to the bit with a union of the copies written out, and its errors.

use scene::nodes::{DistanceWithMaterials, Node, Placement, SdfValue};
use scene::real::{Real, Vec3, vec3};
use scene::{Job, ParseError, ValidationError};
use serde_json::{Value, json};

fn node(value: &Value) -> Node {
    serde_json::from_value(value.clone()).unwrap_or_else(|error| panic!("{error}: {value}"))
}

fn job_of(shape: &Value) -> Result<Job, ParseError> {
    let job = json!({
        "scene": { "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
            "materials": { "clay": { "diffuse": {} }, "red": { "flat": { "color": [1, 0, 0] } }, "fog": { "volume": { "density": 1 } } },
            "objects": [{ "shape": shape }] },
        "image": { "width": 8, "height": 8 }, "frames": { "count": 3, "fps": 1 }
    });
    scene::parse(job.to_string().as_bytes())
}

fn job(shape: &Value) -> Job {
    job_of(shape).unwrap_or_else(|refusal| panic!("{refusal}\n{shape}"))
}

#[track_caller]
fn has_fault(shape: &Value, pointer: &str, words: &str) {
    let Err(ParseError::Invalid(faults)) = job_of(shape) else { panic!("{shape} is valid") };
    let [ValidationError { pointer: at, message, .. }] = faults.as_slice() else { panic!("{faults:#?}") };
    assert!(*at == format!("/scene/objects/0/shape{pointer}") && message.contains(words), "{at}: {message}");
}

fn points() -> impl Iterator<Item = Vec3<f32>> {
    let place = |index: u32, step: u32| index.wrapping_mul(step) as f32 / u32::MAX as f32 * 6.0 - 3.0;
    (0..3_000).map(move |index| vec3(place(index, 0x9e37_79b9), place(index, 0xc13f_a9a9), place(index, 0x91e1_0da5)))
}

/// The copy that a placement stands for, written out.
fn written(placement: &Value, child: &Value) -> Value {
    let mut copy = child.clone();
    if let Some(scale) = placement.get("scale") {
        copy = json!({ "scale": { "by": scale, "child": copy } });
    }
    if let Some(degrees) = placement.get("degrees") {
        copy = json!({ "rotate": { "degrees": degrees, "child": copy } });
    }
    if let Some(by) = placement.get("by") {
        copy = json!({ "translate": { "by": by, "child": copy } });
    }
    match placement.get("material") {
        Some(material) => json!({ "paint": { "material": material, "child": copy } }),
        None => copy,
    }
}

/// Asserts that two shapes of jobs have the same distance and materials, to the bit.
fn assert_same(one: &Job, other: &Job, name: &str) {
    let (one, other) = (&one.scene.objects[0].shape, &other.scene.objects[0].shape);
    for p in points() {
        let (a, b) = (one.distance(p), other.distance(p));
        assert_eq!(a.to_bits(), b.to_bits(), "{name}: {a} and {b} at {p:?}");
        let of = |node: &Node| {
            let value = node.sample::<f32, DistanceWithMaterials<f32>>(p);
            let weights = value
                .weights()
                .iter()
                .map(|w| (w.slot, w.weight.to_bits(), <[f32; 3]>::from(w.point).map(f32::to_bits)));
            (value.distance().to_bits(), weights.collect::<Vec<_>>())
        };
        assert_eq!(of(one), of(other), "{name} at {p:?}");
    }
}

const SHAPES: [&str; 2] = [
    r#"{ "box": { "size": [0.5, 0.3, 0.4] } }"#,
    r#"{ "union": { "smooth": 0.1, "of": [{ "sphere": { "radius": 0.3 } },
        { "paint": { "material": "clay", "child": { "translate": { "by": [0.2, 0.3, 0], "child": { "torus": { "radius": 0.2, "tube": 0.05 } } } } } }] } }"#,
];

/// `count` placements with the keys `with`; some leave keys out.
fn placements(count: usize, with: &[&str]) -> Vec<Value> {
    (0..count)
        .map(|index| {
            let at = |step: usize| (index * step % 101) as f64 / 25.0 - 2.0;
            let mut placement = json!({ "by": [at(37), at(59), at(83)] });
            if with.contains(&"degrees") && index % 3 != 1 {
                placement["degrees"] = json!([at(11) * 90.0, at(13) * 45.0, at(17) * 180.0]);
            }
            if with.contains(&"scale") && index % 4 != 2 {
                placement["scale"] = json!(at(29) + 2.3);
            }
            if with.contains(&"material") && index % 2 == 0 {
                placement["material"] = json!(["clay", "red"][index / 2 % 2]);
            }
            placement
        })
        .collect()
}

#[test]
fn copies_are_the_union_of_the_copies_written_out_to_the_bit() {
    let keys: [&[&str]; 5] = [&[], &["degrees"], &["scale"], &["degrees", "scale"], &["degrees", "scale", "material"]];
    // Many copies have a bounding volume hierarchy.
    for (count, smooth) in [(1, 0.0), (5, 0.0), (5, 0.4), (90, 0.0), (90, 0.4)] {
        for with in keys {
            for shape in SHAPES {
                let child: Value = serde_json::from_str(shape).unwrap();
                let at = placements(count, with);
                let of: Vec<Value> = at.iter().map(|placement| written(placement, &child)).collect();
                let copies = job(&json!({ "copies": { "child": child, "at": at, "smooth": smooth } }));
                let union = job(&json!({ "union": { "of": of, "smooth": smooth } }));
                assert_same(&copies, &union, &format!("{count} {smooth} {with:?}"));
                assert_eq!(copies.scene.used_materials(), union.scene.used_materials());
                let (a, b) = (&copies.scene.objects[0].shape, &union.scene.objects[0].shape);
                assert_eq!(a.lipschitz().to_bits(), b.lipschitz().to_bits());
                let (of_copies, of_union) = (a.bounds(0.1), b.bounds(0.1).expanded(1e-4));
                assert!(of_union.union(of_copies) == of_union, "{of_copies:?} are not in {of_union:?}");
                for (a, b) in [(of_copies.min, of_union.min), (of_copies.max, of_union.max)] {
                    // A smooth union's bounds allow for more than its shapes sink.
                    let is_tight = count == 1 || smooth == 0.0;
                    assert!(
                        !is_tight || (a.x - b.x).abs() + (a.y - b.y).abs() + (a.z - b.z).abs() < 1e-3,
                        "{of_copies:?}, {of_union:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_copy_takes_little_memory() {
    assert!(size_of::<Placement>() <= 100, "{}", size_of::<Placement>());
}

/// Asserts that a form of `at` has the same distances as a list of placements, within some rounding.
fn assert_places(form: &Value, list: &Value) {
    let child = json!({ "box": { "size": [0.3, 0.5, 0.7] } });
    let nodes = [form, list].map(|at| node(&json!({ "copies": { "child": child, "at": at } })));
    for p in points() {
        let [a, b] = [nodes[0].distance(p), nodes[1].distance(p)];
        assert!((a - b).abs() < 2e-6, "{form}: {a} and {b} at {p:?}");
    }
}

#[test]
fn grids_rings_lines_and_columns_are_lists_of_placements() {
    let mut grid = Vec::new();
    for (x, y, z) in (0..3).flat_map(|x| (0..2).flat_map(move |y| (0..1).map(move |z| (x, y, z)))) {
        grid.push(json!({ "by": [0.9 * f64::from(x - 1), 0.7 * (f64::from(y) - 0.5), 5.0 * f64::from(z)] }));
    }
    assert_places(&json!({ "grid": [3, 2, 1], "step": [0.9, 0.7, 5] }), &json!(grid));
    let half = 3_f64.sqrt() / 2.0;
    let ring = json!([
        { "by": [0, 0, 1.5] },
        { "by": [1.5 * half, 0, -0.75], "degrees": [0, 120, 0] },
        { "by": [-1.5 * half, 0, -0.75], "degrees": [0, 240, 0] }
    ]);
    assert_places(&json!({ "ring": 3, "radius": 1.5 }), &ring);
    let along = json!([{ "by": [-1, 0, 0] }, { "by": [0, 0, 0] }, { "by": [1, 0, 0] }, { "by": [1, 1, 0] }, { "by": [1, 2, 0] }]);
    assert_places(&json!({ "along": [[-1, 0, 0], [1, 0, 0], [1, 0, 0], [1, 2, 0]], "count": 5 }), &along);
    assert_places(&json!({ "along": [[-1, 0, 0], [1, 0, 0]], "count": 1 }), &json!([{ "by": [-1, 0, 0] }]));
    assert_places(
        &json!({ "by": [[1, 0, 0], [0, 1, 0]], "degrees": [[0, 0, 0], [0, 90, 30]], "scale": [1, 0.5] }),
        &json!([{ "by": [1, 0, 0] }, { "by": [0, 1, 0], "degrees": [0, 90, 30], "scale": 0.5 }]),
    );
    assert_places(&json!({ "scale": [1, 2] }), &json!([{}, { "scale": 2 }]));
}

#[test]
fn a_ring_faces_outward() {
    let marked = json!({ "translate": { "by": [0, 0, 0.3], "child": { "sphere": { "radius": 0.1 } } } });
    let ring = node(&json!({ "copies": { "child": marked, "at": { "ring": 12, "radius": 2 } } }));
    for index in 0..12 {
        let (s, c) = Real::sin_cos(index as f32 * std::f32::consts::TAU / 12.0);
        assert!(ring.distance(vec3(2.3 * s, 0.0, 2.3 * c)) < -0.099, "copy {index}");
    }
}

#[test]
fn every_number_of_a_placement_changes_the_cache_key() {
    let key = |at: Value| {
        let child = json!({ "sphere": { "radius": 0.4 } });
        job(&json!({ "copies": { "child": child, "at": at } })).cache_key(0)
    };
    let forms = [
        json!([{ "by": [1, 0, 0] }]),
        json!([{ "by": [1, 0, 0.5] }]),
        json!([{ "by": [1, 0, 0], "degrees": [0, 0, 1] }]),
        json!([{ "by": [1, 0, 0], "scale": 1.5 }]),
        json!([{ "by": [1, 0, 0], "material": "red" }]),
        json!([{ "by": [1, 0, 0] }, { "by": [1, 0, 0] }]),
        json!({ "grid": [2, 1, 1], "step": [1, 0, 0] }),
        json!({ "grid": [2, 1, 1], "step": [1.5, 0, 0] }),
        json!({ "grid": [3, 1, 1], "step": [1, 0, 0] }),
        json!({ "ring": 4, "radius": 1 }),
        json!({ "ring": 4, "radius": 2 }),
        json!({ "ring": 5, "radius": 2 }),
        json!({ "along": [[0, 0, 0], [1, 0, 0]], "count": 3 }),
        json!({ "along": [[0, 0, 0], [1, 0, 0]], "count": 4 }),
        json!({ "along": [[0, 0, 0], [1, 2, 0]], "count": 4 }),
    ];
    let keys: std::collections::HashSet<_> = forms.iter().map(|form| key(form.clone())).collect();
    assert_eq!(keys.len(), forms.len());
    assert_eq!(key(json!([{ "by": [1, 0, 0], "scale": 1 }])), key(json!({ "by": [[1, 0, 0]] })));
}

#[test]
fn numbers_of_the_child_may_be_animated() {
    let child = json!({ "sphere": { "radius": { "keys": [[0, 0.2], [2, 0.6]] } } });
    let job =
        job(&json!({ "copies": { "child": child, "at": { "grid": [3, 3, 3], "step": [1, 1, 1] }, "smooth": 0.1 } }));
    let at = |frame, p| job.at(frame).unwrap().scene().objects[0].shape.distance(p);
    let p = vec3(1.0, 1.0, 1.0_f32);
    assert_eq!([at(0, p), at(2, p)], [-0.2, -0.6]);
}

#[test]
fn nodes_are_counted_once_for_each_copy() {
    let child = json!({ "onion": { "thickness": 0.1, "child": { "sphere": { "radius": 0.4 } } } });
    assert_eq!(
        job(&json!({ "copies": { "child": child, "at": { "grid": [10, 10, 10], "step": [1, 1, 1] } } })).nodes(),
        2001
    );
}

fn copies(at: &Value) -> Value {
    json!({ "copies": { "child": { "sphere": { "radius": 0.4 } }, "at": at } })
}

#[test]
fn too_many_copies_are_rejected_before_they_are_made() {
    has_fault(
        &copies(&json!({ "ring": 1_000_000_000, "radius": 1 })),
        "/copies/at/ring",
        "must be 1 to 1000000 copies",
    );
    has_fault(
        &copies(&json!({ "grid": [1000, 1000, 1000], "step": [1, 1, 1] })),
        "/copies/at",
        "makes 1000000000 copies",
    );
    let nested = copies(&json!({ "ring": 1_000_000, "radius": 1 }));
    let nested = json!({ "copies": { "child": nested, "at": { "ring": 1_000_000, "radius": 1 } } });
    let Err(ParseError::Invalid(faults)) = job_of(&json!({ "repeat": { "cell": [1, 1, 1], "child": nested } })) else {
        panic!("it is valid")
    };
    assert_eq!(faults.len(), 1, "{faults:?}");
    let place = "/scene/objects/0/shape/repeat/child/copies/child/copies";
    assert!(
        faults[0].pointer == place && faults[0].message.contains("makes 1000001 nodes of its copies"),
        "{faults:?}"
    );
}

#[test]
fn errors_in_placements_have_their_place_and_fix() {
    for (at, pointer, words) in [
        (json!([]), "/at", "is empty: write a placement"),
        (json!({}), "/at", "is not one of the forms of placements: write a list"),
        (json!([{ "by": [0, 0, 0] }, { "by": [0, 2e6, 0] }]), "/at/1/by/1", "within ±1e6"),
        (json!([{ "by": [0, { "keys": [[0, 1]] }, 0] }]), "/at/0/by/1", "cannot be a track: write a number"),
        (json!([{ "degrees": [0, 0, "1"] }]), "/at/0/degrees/2", "must be a number, not \"1\""),
        (json!([{ "scale": 0 }]), "/at/0/scale", "from 1e-6"),
        (json!([{ "turn": [0, 0, 1] }]), "/at/0/turn", "unknown key"),
        (json!([{ "material": "caly" }]), "/at/0/material", "did you mean \"clay\"?"),
        (json!([{ "material": "fog" }]), "/at/0/material", "fills a whole object"),
        (json!([[[0, 0, 0]]]), "/at/0", "must be an object, not a list"),
        (json!({ "grid": [2, 2, 2] }), "/at", "is not one of the forms"),
        (json!({ "grid": [2, 2, 0], "step": [1, 1, 1] }), "/at/grid/2", "must be 1 to 1000000"),
        (json!({ "grid": [2, 2, 2], "step": [1, 1, 1], "ring": 5 }), "/at", "is not one of the forms"),
        (json!({ "grid": [90_000, 1, 1], "step": [100, 1, 1] }), "/at/step/0", "use a smaller step"),
        (json!({ "along": [[0, 0, 0]], "count": 5 }), "/at/along", "two points or more"),
        (json!({ "along": [[1, 0, 0], [1, 0, 0]], "count": 5 }), "/at/along", "has no length"),
        (json!({ "by": [[0, 0, 0]], "scale": [1, 2] }), "/at", "has 1 entries in \"by\" and 2 in \"scale\""),
        (json!({ "ring": 3, "radius": 1, "steps": 1 }), "/at/steps", "did you mean `step`?"),
    ] {
        has_fault(&copies(&at), &format!("/copies{pointer}"), words);
    }
    has_fault(&json!({ "copies": { "at": { "ring": 3, "radius": 1 } } }), "/copies", "lacks the key `child`");
}
