//! Contract tests that every material and every texture must pass, run on each one's own examples. No test names a
//! kind.

use crate::subject as scene;
use scene::lights::LightSample;
use scene::materials::{Example, IncidentLight, Material, ShadingPoint, Texture};
use scene::real::{MaskValue, Vec3, vec3};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// Pseudorandom numbers from a fixed seed, so that failures repeat.
struct Random(u32);

impl Random {
    fn next(&mut self, low: f32, high: f32) -> f32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((self.0 >> ((self.0 >> 28) + 4)) ^ self.0).wrapping_mul(277_803_737);
        low + (high - low) * (((word >> 22) ^ word) >> 8) as f32 / (1 << 24) as f32
    }

    fn point(&mut self, reach: f32) -> Vec3<f32> {
        vec3(self.next(-reach, reach), self.next(-reach, reach), self.next(-reach, reach))
    }

    fn direction(&mut self) -> Vec3<f32> {
        loop {
            let v = self.point(1.0);
            if (0.01..=1.0).contains(&v.length()) {
                return v.normalize();
            }
        }
    }

    /// A random shading point, seen from the side of its normal, often edge-on.
    fn place(&mut self, reach: f32) -> ShadingPoint<f32> {
        let normal = self.direction();
        let mut to_viewer = self.direction();
        let facing = normal.dot(to_viewer);
        if facing < 0.0 {
            to_viewer = -to_viewer;
        }
        if self.next(0.0, 1.0) < 0.3 {
            to_viewer = normal.mul_add(-facing.abs() * self.next(0.99, 1.0), to_viewer).normalize();
        }
        ShadingPoint {
            normal,
            to_viewer,
            local_point: self.point(reach),
            local_normal: self.direction(),
            camera_t: self.next(0.0, reach),
            footprint: [self.point(0.1), self.point(0.1)],
            is_inside: MaskValue(self.next(0.0, 1.0) < 0.5),
        }
    }

    fn light(&mut self) -> LightSample<f32> {
        let brightness = self.next(0.0, 10.0);
        LightSample { direction: self.direction(), radiance: vec3(brightness, 1.0, 0.0) }
    }
}

fn parsed<T: DeserializeOwned>(example: &Example) -> T {
    serde_json::from_str(&example.json).unwrap_or_else(|error| panic!("{} {}: {error}", example.kind, example.index))
}

fn each_material(mut check: impl FnMut(&str, &Material)) {
    for example in Material::examples() {
        check(&format!("{} {}", example.kind, example.index), &parsed(&example));
    }
}

fn each_texture(mut check: impl FnMut(&str, &Texture)) {
    for example in Texture::examples() {
        check(&format!("{} {}", example.kind, example.index), &parsed(&example));
    }
}

fn assert_survives_json<T: Serialize + DeserializeOwned + PartialEq + std::fmt::Debug>(kind: &str, value: &T) {
    let text = serde_json::to_string(value).unwrap();
    assert_eq!(&serde_json::from_str::<T>(&text).unwrap(), value, "{kind}");
}

fn assert_finite(kind: &str, color: Vec3<f32>, place: &ShadingPoint<f32>) {
    let is_light = |c: f32| c.is_finite() && c >= 0.0;
    assert!(is_light(color.x) && is_light(color.y) && is_light(color.z), "{kind} is {color:?} at {place:?}");
}

#[test]
fn materials_and_textures_survive_a_json_round_trip() {
    each_material(assert_survives_json);
    each_texture(assert_survives_json);
}

#[test]
fn the_schema_describes_every_material_and_texture_with_keys() {
    let schema = scene::schema();
    for Example { kind, json, .. } in Material::examples().into_iter().chain(Texture::examples()) {
        let definition = &schema["$defs"][kind];
        assert!(definition["description"].is_string(), "{kind} has no description");
        assert_eq!(definition["additionalProperties"], false, "{kind} takes unknown keys");
        let value: Value = serde_json::from_str(&json).unwrap();
        let (_, value) = value.as_object().unwrap().iter().next().unwrap();
        for key in value.as_object().unwrap().keys() {
            assert!(definition["properties"][key].is_object(), "{kind}.{key} is not in the schema");
        }
        for (key, property) in definition["properties"].as_object().into_iter().flatten() {
            assert!(property["description"].is_string(), "{kind}.{key} has no description");
        }
    }
}

#[test]
fn textures_are_finite_and_never_negative() {
    each_texture(|kind, texture| {
        let mut random = Random(1);
        for reach in [0.0, 1e-6, 1.0, 10.0, 1e3, 1e6] {
            for _ in 0..2_000 {
                let place = random.place(reach);
                assert_finite(kind, texture.color(&place), &place);
            }
        }
    });
}

#[test]
fn shaded_light_is_finite_and_never_negative() {
    each_material(|kind, material| {
        let mut random = Random(2);
        for reach in [0.0, 1e-6, 1.0, 10.0, 1e3, 1e6] {
            for round in 0..1_000 {
                let place = random.place(reach);
                let light = IncidentLight {
                    lights: (0..round % 3).map(|_| random.light()).collect(),
                    ambient: (round % 2 == 0).then(|| vec3(1.0, 0.5, 0.0)),
                    ambient_visibility: (round % 5 == 0).then(|| random.next(0.0, 1.0)),
                    shadow: None,
                };
                assert_finite(kind, material.shade(&place, &light), &place);
                assert_finite(kind, material.albedo(&place), &place);
            }
        }
    });
}

#[test]
fn a_material_reflects_and_transmits_no_more_than_arrives() {
    each_material(|kind, material| {
        let mut random = Random(3);
        for _ in 0..2_000 {
            let place = random.place(3.0);
            let Some(finish) = material.specular(&place) else { return };
            assert!((0.0..=1.000_001).contains(&finish.roughness), "{kind} has a roughness of {}", finish.roughness);
            assert!(finish.ior.is_finite() && finish.ior >= 1.0, "{kind} has an index of refraction of {}", finish.ior);
            for (mirrored, passed) in <[f32; 3]>::from(finish.f0).into_iter().zip(<[f32; 3]>::from(finish.transmission))
            {
                assert!((0.0..=1.000_001).contains(&mirrored), "{kind} reflects {mirrored}");
                assert!((0.0..=1.000_001).contains(&passed), "{kind} lets {passed} through");
            }
        }
    });
}

#[test]
fn only_materials_that_need_the_local_normal_use_it() {
    let mut random = Random(4);
    let mut pairs = || {
        let place = random.place(3.0);
        (place, ShadingPoint { local_normal: random.direction(), ..place })
    };
    each_texture(|kind, texture| {
        let differs = (0..500).map(|_| pairs()).any(|(one, other)| texture.color(&one) != texture.color(&other));
        assert_eq!(differs, texture.needs_own_normal(), "{kind}");
    });
    each_material(|kind, material| {
        let light = IncidentLight {
            ambient: Some(vec3(1.0, 1.0, 1.0)),
            ambient_visibility: None,
            shadow: None,
            lights: Vec::new(),
        };
        let shade = |place: &ShadingPoint<f32>| material.shade(place, &light);
        let differs = (0..500).map(|_| pairs()).any(|(one, other)| shade(&one) != shade(&other));
        assert!(!differs || material.needs_local_normal(), "{kind}");
    });
}

#[test]
fn unlit_materials_have_the_same_color_in_any_light() {
    each_material(|kind, material| {
        let mut random = Random(5);
        let mut differs = false;
        for _ in 0..200 {
            let place = random.place(3.0);
            let lit =
                IncidentLight { lights: vec![random.light()], ambient: None, ambient_visibility: None, shadow: None };
            differs |= material.shade(&place, &lit) != material.shade(&place, &IncidentLight::default());
            let behind = |shadow| material.transparency(&IncidentLight { shadow: Some(shadow), ..lit.clone() });
            differs |= behind(0.2) != behind(0.7);
        }
        assert_eq!(differs, material.is_lit(), "{kind}");
    });
}

/// Pointer and message of the only error of a job with this first material.
fn fault(material: &str) -> (String, String) {
    let text = format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }}, "materials": {{ "m": {material} }},
              "objects": [{{ "shape": {{ "sphere": {{ "radius": 1 }} }}, "material": "m" }}] }},
            "image": {{ "width": 8, "height": 8 }} }}"#
    );
    match scene::parse(text.as_bytes()) {
        Err(scene::ParseError::Invalid(faults)) if faults.len() == 1 => {
            let fault = &faults[0];
            assert!(fault.line > 0 && fault.column > 1, "{fault} has no position");
            (fault.pointer.clone(), fault.message.clone())
        }
        other => panic!("{material} gives {other:?}"),
    }
}

#[test]
fn an_invalid_texture_is_rejected_with_pointer_and_fix() {
    let flat = |texture: &str| format!(r#"{{ "flat": {{ "color": {texture} }} }}"#);
    let ramp = |stops: &str| flat(&format!(r#"{{ "gradient": {{ "by": {{ "facing": {{}} }}, "ramp": {stops} }} }}"#));
    let many: Vec<String> = (0..33).map(|stop| format!("[{}, [0, 0, 0]]", f64::from(stop) / 32.0)).collect();
    let mut nested = "[0, 0, 0]".to_owned();
    for _ in 0..5 {
        nested = format!(r#"{{ "stripes": {{ "width": 1, "colors": [[1, 1, 1], {nested}] }} }}"#);
    }
    let metallic = |value: &str| format!(r#"{{ "surface": {{ "metallic": {value} }} }}"#);
    let cases = [
        (ramp("[[0.5, [0, 0, 0]], [0.2, [1, 1, 1]]]"), "/flat/color/gradient/ramp/1", "put stops in order"),
        (ramp("[[0.5, [0, 0, 0]]]"), "/flat/color/gradient/ramp", "at least 2 stops"),
        (ramp(&format!("[{}]", many.join(", "))), "/flat/color/gradient/ramp", "more than 32 stops"),
        (ramp("[[0, [0, 0, 0]], [1.5, [1, 1, 1]]]"), "/flat/color/gradient/ramp/1/0", "a fraction from 0 to 1"),
        (ramp(r##"[[0, [0, 0, 0]], [1, "#12"]]"##), "/flat/color/gradient/ramp/1/1", "a color"),
        (flat(r#"{ "checker": { "cell": 0 } }"#), "/flat/color/checker/cell", "a size from 1e-6"),
        (flat(r#"{ "checker": { "cell": 1, "colour": 1 } }"#), "/flat/color/checker/colour", "did you mean `colors`?"),
        (flat(r#"{ "chequer": { "cell": 1 } }"#), "/flat/color/chequer", "did you mean `checker`?"),
        (flat("[1, 2]"), "/flat/color", "a color"),
        (flat("7"), "/flat/color", "or a texture"),
        (flat(&nested), "/flat/color", "nest at most 4"),
        (metallic("2"), "/surface/metallic", "a fraction from 0 to 1"),
        (metallic(r#"{ "bricks": {} }"#), "/surface/metallic", r#"{"low": …, "high": …, "by": {"bricks": …}}"#),
        (metallic(r#"{ "low": 0, "high": 2, "by": { "bricks": {} } }"#), "/surface/metallic/high", "from 0 to 1"),
        (metallic(r#"{ "low": 0, "by": { "bricks": {} } }"#), "/surface/metallic", "lacks the key `high`"),
    ];
    for (material, pointer, message) in cases {
        let (got, words) = fault(&material);
        assert_eq!(got, format!("/scene/materials/m{pointer}"), "{material}: {words}");
        assert!(words.contains(message), "{material}: {words}");
    }
}

#[test]
fn a_misplaced_texture_is_rejected_with_a_fix() {
    let sphere = |radius: &str, color: &str| {
        let text = format!(
            r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }}, "background": {{ "color": {color} }},
                  "objects": [{{ "shape": {{ "sphere": {{ "radius": {radius} }} }} }}] }},
                "image": {{ "width": 8, "height": 8 }} }}"#
        );
        scene::parse(text.as_bytes()).map_err(|refusal| refusal.to_string())
    };
    let texture = r#"{ "checker": { "cell": 1 } }"#;
    assert!(sphere("1", "[0, 0, 0]").is_ok());
    for (job, pointer) in [
        (sphere(texture, "[0, 0, 0]"), "/scene/objects/0/shape/sphere/radius: "),
        (sphere("1", texture), "/scene/background/color: "),
    ] {
        let words = job.expect_err("a texture is where none is allowed");
        assert!(words.contains(&format!("{pointer}takes no texture: write ")), "{words}");
    }
}

/// The JSON pointers of all numbers in a value.
fn numbers(value: &Value, pointer: &str, found: &mut Vec<String>) {
    match value {
        Value::Number(_) => found.push(pointer.to_owned()),
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(index, item)| numbers(item, &format!("{pointer}/{index}"), found));
        }
        Value::Object(entries) => {
            entries.iter().for_each(|(key, entry)| numbers(entry, &format!("{pointer}/{key}"), found));
        }
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

#[test]
fn animated_and_constant_numbers_give_the_same_color() {
    // A texture is tested through a material that shows only its color.
    let textures = Texture::examples()
        .into_iter()
        .map(|example| Example { json: format!(r#"{{ "flat": {{ "color": {} }} }}"#, example.json), ..example });
    for example in Material::examples().into_iter().chain(textures) {
        let value: Value = serde_json::from_str(&example.json).unwrap();
        let constant: Material = parsed(&example);
        let mut found = Vec::new();
        numbers(&value, "", &mut found);
        for pointer in found {
            let mut changed = value.clone();
            let number = changed.pointer_mut(&pointer).unwrap();
            *number = json!({ "keys": [[0, number.clone()]] });
            let moving: Material = match serde_json::from_value(changed) {
                Ok(moving) => moving,
                Err(error) => {
                    assert!(error.to_string().contains("is a count"), "{} {pointer}: {error}", example.kind);
                    continue;
                }
            };
            let mut random = Random(6);
            for _ in 0..100 {
                let place = random.place(2.0);
                let light = IncidentLight {
                    lights: vec![random.light()],
                    ambient: None,
                    ambient_visibility: None,
                    shadow: None,
                };
                let (got, want) = (moving.shade(&place, &light), constant.shade(&place, &light));
                let off = (got - want).length();
                assert!(off <= 1e-4 * want.length().max(1.0), "{} {pointer}: {got:?} for {want:?}", example.kind);
            }
        }
    }
}
