//! Contract tests that every noise must pass, run on each kind with each way of summing it. No test names a kind.

use scene::noise::Noise;
use scene::real::{Interval, Vec3, vec3};
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
}

/// Every form of a noise: each kind, with each possible value of each key.
fn forms() -> Vec<Value> {
    let schema = serde_json::to_value(schemars::schema_for!(Noise)).unwrap();
    let mut forms = Vec::new();
    for choice in schema["oneOf"].as_array().unwrap() {
        let (kind, of_kind) = choice["properties"].as_object().unwrap().iter().next().unwrap();
        let definition = of_kind["$ref"].as_str().unwrap().rsplit('/').next().unwrap();
        assert_eq!(schema["$defs"][definition]["additionalProperties"], false, "{kind} takes unknown keys");
        let mut values = vec![json!({})];
        for (key, property) in schema["$defs"][definition]["properties"].as_object().unwrap() {
            assert!(property["description"].is_string(), "{kind}.{key} has no description");
            let words = choices(&schema, property);
            values = values
                .iter()
                .flat_map(|value| words.iter().map(|word| with(value, key, word.clone())).collect::<Vec<_>>())
                .chain(words.is_empty().then(|| values.clone()).into_iter().flatten())
                .collect();
        }
        forms.extend(values.into_iter().map(|value| json!({ kind: value })));
    }
    forms
}

/// The words that a property allows, if it is an enum.
fn choices(schema: &Value, property: &Value) -> Vec<Value> {
    let definition = match property["$ref"].as_str() {
        Some(place) => &schema["$defs"][place.rsplit('/').next().unwrap()],
        None => property,
    };
    let words = definition["oneOf"].as_array().into_iter().flatten();
    words.filter_map(|word| word.get("const").cloned()).collect()
}

fn with(value: &Value, key: &str, word: Value) -> Value {
    let mut value = value.clone();
    value[key] = word;
    value
}

/// Parameters of the sum of octaves.
fn sums() -> [Value; 4] {
    [
        json!({}),
        json!({ "scale": 0.5, "seed": u32::MAX, "octaves": 4 }),
        json!({ "scale": 3, "octaves": 3, "lacunarity": 2.7, "gain": 0.7, "seed": 7 }),
        json!({ "scale": 0.7, "octaves": 2, "warp": 0.4 }),
    ]
}

fn noise(form: &Value, sum: &Value) -> (String, Noise) {
    let mut form = form.clone();
    let (_, value) = form.as_object_mut().unwrap().iter_mut().next().unwrap();
    for (key, number) in sum.as_object().unwrap() {
        value[key] = number.clone();
    }
    let noise = serde_json::from_value(form.clone()).unwrap_or_else(|error| panic!("{form}: {error}"));
    (form.to_string(), noise)
}

/// Each form with each sum.
fn each_noise(mut check: impl FnMut(&str, &Noise)) {
    for form in forms() {
        for sum in &sums() {
            let (name, noise) = noise(&form, sum);
            check(&name, &noise);
        }
    }
}

/// Each form alone.
fn each_single_noise(mut check: impl FnMut(&str, &Noise)) {
    for form in forms() {
        let (name, noise) = noise(&form, &json!({}));
        check(&name, &noise);
    }
}

#[test]
fn a_noise_survives_a_json_round_trip() {
    each_noise(|name, noise| {
        let text = serde_json::to_string(noise).unwrap();
        assert_eq!(&serde_json::from_str::<Noise>(&text).unwrap(), noise, "{name}");
    });
}

#[test]
fn invalid_numbers_are_rejected_with_their_range() {
    for form in forms() {
        for (wrong, words) in [
            (json!({ "octaves": 99 }), "must be 1 to 12 octaves, not 99"),
            (json!({ "octaves": 0 }), "must be 1 to 12 octaves, not 0"),
            (json!({ "lacunarity": 5 }), "must be a lacunarity from 1 to 4, not 5"),
            (json!({ "gain": -0.5 }), "must be a gain from 0 to 1, not -0.5"),
            (json!({ "scale": 0 }), "must be a factor from 1e-6 to 1e6, not 0"),
            (json!({ "seed": -1 }), "must be 0 to 4294967295 as a seed, not -1"),
            (json!({ "persistence": 0.5 }), "unknown field `persistence`"),
        ] {
            let mut form = form.clone();
            let (_, value) = form.as_object_mut().unwrap().iter_mut().next().unwrap();
            for (key, number) in wrong.as_object().unwrap() {
                value[key] = number.clone();
            }
            let error = serde_json::from_value::<Noise>(form.clone()).unwrap_err().to_string();
            assert!(error.contains(words), "{form}: {error}");
        }
    }
}

#[test]
fn values_are_finite_and_in_range_everywhere() {
    let mut sums = sums().to_vec();
    sums.push(json!({ "scale": 1e6, "octaves": 12, "lacunarity": 4, "gain": 1, "warp": 1e6 }));
    sums.push(json!({ "scale": 1e-6, "octaves": 12, "lacunarity": 1, "gain": 0 }));
    for form in forms() {
        for sum in &sums {
            let (name, noise) = noise(&form, sum);
            let (low, high) = noise.range();
            assert!(low < high && noise.lipschitz() > 0.0 && noise.lipschitz().is_finite(), "{name}");
            let mut random = Random(1);
            for reach in [0.0, 1e-6, 1.0, 30.0, 1e3, 1e6] {
                for _ in 0..200 {
                    let p = random.point(reach);
                    let value = noise.value(p);
                    assert!((low..=high).contains(&value), "{name} is {value} at {p:?}, not {low} to {high}");
                }
            }
        }
    }
}

/// Checks pairs of points near each other, most of them in one cell.
fn check_slope(name: &str, noise: &Noise, pairs: u32) {
    let mut random = Random(2);
    let lipschitz = noise.lipschitz();
    for _ in 0..pairs {
        let (p, size) = (random.point(6.0), random.next(0.0, 1.0));
        let q = random.direction().mul_add(size * size * size, p);
        let (a, b) = (noise.value(p), noise.value(q));
        let apart = vec3(p.x - q.x, p.y - q.y, p.z - q.z).length();
        // The points themselves are rounded before the noise is evaluated, to 8 units of their last place.
        let rounding = 8.0 * f32::EPSILON * (1.0 + 6.0 * lipschitz);
        assert!((a - b).abs() <= lipschitz * apart + rounding, "{name}: {a} at {p:?}, {b} at {q:?}");
    }
}

#[test]
fn a_noise_changes_within_its_lipschitz_factor() {
    each_single_noise(|name, noise| check_slope(name, noise, 100_000));
}

#[test]
fn a_sum_of_octaves_changes_within_its_lipschitz_factor() {
    each_noise(|name, noise| check_slope(name, noise, 10_000));
}

#[test]
fn lipschitz_factors_and_ranges_are_tight() {
    each_single_noise(|name, noise| {
        let mut random = Random(3);
        let (mut steepest, mut least, mut most) = (0.0_f32, f32::INFINITY, f32::NEG_INFINITY);
        let half = 5e-3;
        for _ in 0..20_000 {
            let p = random.point(30.0);
            let across = random.direction();
            let ends = [-half, half].map(|step| noise.value(across.mul_add(step, p)));
            steepest = steepest.max((ends[1] - ends[0]).abs() / (2.0 * half));
            (least, most) = (least.min(ends[0]), most.max(ends[0]));
        }
        let (low, high) = noise.range();
        assert!(
            noise.lipschitz() <= 2.5 * steepest,
            "{name}: {steepest} was found, the factor is {}",
            noise.lipschitz()
        );
        assert!(high - low <= 1.5 * (most - least), "{name}: {least} to {most} was seen, {low} to {high} is said");
    });
}

#[test]
fn an_interval_contains_every_value_inside_its_box() {
    each_noise(|name, noise| {
        let mut random = Random(4);
        let (low, high) = noise.range();
        for round in 0..40 {
            let (corner, edge) = (random.point(2.5), [2.0, 0.5, 0.05, 1e-3][round % 4]);
            let ends = |low: f32| Interval::new(low, low + edge);
            let range: Interval = noise.value(vec3(ends(corner.x), ends(corner.y), ends(corner.z)));
            assert!(low <= range.low && range.high <= high, "{name}: {range:?}");
            for _ in 0..8 {
                let within = |low: f32, random: &mut Random| random.next(low, low + edge).clamp(low, low + edge);
                let p =
                    vec3(within(corner.x, &mut random), within(corner.y, &mut random), within(corner.z, &mut random));
                let value = noise.value(p);
                assert!(range.contains(value), "{name}: {value} at {p:?} is not in {range:?}");
            }
        }
    });
}

#[test]
fn no_axis_and_no_sign_is_preferred() {
    each_single_noise(|name, noise| {
        const POINTS: u32 = 20_000;
        let mut random = Random(5);
        let (mut sum, mut slopes, half) = (0.0, [0.0_f32; 3], 0.01);
        for _ in 0..POINTS {
            let p = random.point(100.0);
            sum += noise.value(p);
            let steps = [vec3(half, 0.0, 0.0), vec3(0.0, half, 0.0), vec3(0.0, 0.0, half)];
            for (slope, step) in slopes.iter_mut().zip(steps) {
                let change = noise.value(p + step) - noise.value(p - step);
                *slope += change * change;
            }
        }
        let (low, high) = noise.range();
        if low == -high {
            let mean = sum / POINTS as f32;
            assert!(mean.abs() < 0.02, "{name}: the mean is {mean}");
        }
        // Gardner's waves run along x and y, and z shifts both.
        let [x, y, _] = slopes;
        let least = slopes.into_iter().fold(f32::INFINITY, f32::min);
        let most = slopes.into_iter().fold(0.0, f32::max);
        let even = if name.contains("gardner") { x.max(y) / x.min(y) } else { most / least };
        assert!(even < 1.06, "{name}: mean squares of slopes along the axes {slopes:?}");
    });
}

#[test]
fn seeds_make_different_noises_and_vectors_of_three() {
    each_single_noise(|name, noise| {
        let mut value = serde_json::to_value(noise).unwrap();
        value.as_object_mut().unwrap().iter_mut().next().unwrap().1["seed"] = json!(1);
        let other: Noise = serde_json::from_value(value).unwrap();
        let p = vec3(0.4, 0.3, 0.2);
        let Vec3 { x, y, z } = noise.vector(p);
        let values = [noise.value(p), other.value(p), x, y, z];
        for (index, value) in values.iter().enumerate() {
            assert!(!values[..index].contains(value), "{name}: {values:?}");
        }
    });
}

#[test]
fn noise_values_are_bit_identical_to_the_golden_file() {
    let mut got = Vec::new();
    each_noise(|name, noise| {
        let mut random = Random(6);
        let bits = [1.0, 100.0, 1e5].map(|reach| format!("{:08x}", noise.value(random.point(reach)).to_bits()));
        got.push(format!("{name} {}", bits.join(" ")));
    });
    let want = include_str!("noise.txt");
    for (got, want) in got.iter().zip(want.lines()) {
        assert_eq!(got, want);
    }
    assert_eq!(got.len(), want.lines().count(), "tests/noise.txt should be:\n{}", got.join("\n"));
}
