//! Path tracing: its estimates agree with integrals that are known, and with each other.

#![expect(clippy::disallowed_methods, reason = "expected values are computed in f64 by std's functions")]

use scene::{Integrator, parse};
use serde_json::{Value, json};

/// Mean of a pixel's channel over seeds, and its standard deviation.
pub(crate) fn estimate(job: &Value, samples: u32, seeds: u32) -> ([f64; 3], [f64; 3]) {
    let (mut sum, mut squares) = ([0.0; 3], [0.0; 3]);
    for seed in 0..seeds {
        let mut job = job.clone();
        job["image"] = json!({ "width": 8, "height": 8, "samples": samples, "seed": seed });
        let job = parse(job.to_string().as_bytes()).expect("valid");
        let at_frame = job.at(0).expect("a frame");
        let seen = Integrator::new(&at_frame).pixel(3.0_f32, 4.0);
        for (index, channel) in <[f32; 3]>::from(seen.color).into_iter().enumerate() {
            sum[index] += f64::from(channel);
            squares[index] += f64::from(channel).powi(2);
        }
    }
    let n = f64::from(seeds);
    let mean = sum.map(|sum| sum / n);
    let deviation = [0, 1, 2].map(|i: usize| ((squares[i] / n - mean[i] * mean[i]).max(0.0) / (n - 1.0)).sqrt());
    (mean, deviation)
}

/// Fails unless a pixel has a known value, within three standard deviations and what `f32` and the march round.
pub(crate) fn assert_is(job: &Value, wanted: [f64; 3]) {
    let (mean, deviation) = estimate(job, 640, 16);
    for ((mean, deviation), wanted) in mean.into_iter().zip(deviation).zip(wanted) {
        let tolerance = 3.0 * deviation + 1e-4 * wanted;
        assert!((mean - wanted).abs() <= tolerance, "{mean} ± {deviation}, not {wanted}: {job}");
        assert!(deviation < 0.05 * wanted, "{mean} ± {deviation} says nothing: {job}");
    }
}

pub(crate) fn assert_equal(jobs: &[(&str, Value)]) {
    let seen: Vec<_> = jobs.iter().map(|(name, job)| (name, estimate(job, 1024, 24))).collect();
    for (name, (mean, deviation)) in &seen {
        for (other_name, (other, other_deviation)) in &seen {
            for channel in 0..3 {
                let spread = (deviation[channel].powi(2) + other_deviation[channel].powi(2)).sqrt();
                let difference = (mean[channel] - other[channel]).abs();
                assert!(difference <= 3.5 * spread + 2e-4 * mean[channel], "{name} and {other_name}: {seen:?}");
                assert!(mean[channel] > 0.0 && spread < 0.1 * mean[channel], "{name} says nothing: {seen:?}");
            }
        }
    }
}

pub(crate) fn job(max_bounces: u32, rest: Value) -> Value {
    let mut scene = json!({
        "integrator": { "path": { "max_bounces": max_bounces } },
        "camera": { "position": [0.1, 0.2, 0.3], "look_at": [0.4, -1, 0.6] },
        "background": { "color": [0, 0, 0] },
        "lights": []
    });
    let Value::Object(rest) = rest else { panic!("members of a scene") };
    scene.as_object_mut().expect("an object").extend(rest);
    json!({ "scene": scene })
}

fn closed_box(material: &Value) -> Value {
    let shell =
        json!({ "difference": { "of": [{ "box": { "size": [4, 3, 5] } }, { "box": { "size": [3.8, 2.8, 4.8] } }] } });
    json!([{ "material": material, "shape": shell }])
}

#[test]
fn a_closed_box_that_shines_glows_evenly() {
    // Emission and its reflections: a geometric series, cut off after the last bounce.
    for (albedo, emission, bounces) in [(0.5_f64, 0.3_f64, 20), (0.8, 0.2, 32), (0.8, 1.0, 0), (0.8, 1.0, 3)] {
        let surface = json!({ "surface": {
            "base_color": [albedo, albedo, albedo], "ior": 1, "roughness": 1, "emission": [emission, emission, emission]
        } });
        let wanted = emission * (1.0 - albedo.powi(bounces + 2)) / (1.0 - albedo);
        assert_is(&job(bounces.unsigned_abs(), json!({ "objects": closed_box(&surface) })), [wanted; 3]);
    }
}

#[test]
fn white_surfaces_vanish_in_a_white_sky() {
    let shapes = json!([
        { "sphere": { "radius": 1 } },
        { "union": { "smooth": 0.3, "of": [
            { "torus": { "radius": 1, "tube": 0.4 } }, { "box": { "size": [1, 2, 0.6] } }
        ] } }
    ]);
    for shape in shapes.as_array().expect("shapes") {
        for material in [
            json!({ "diffuse": { "kd": [1, 1, 1] } }),
            json!({ "surface": { "base_color": [1, 1, 1], "metallic": 1, "roughness": 0.02 } }),
            json!({ "surface": { "base_color": [1, 1, 1], "roughness": 0.02, "transmission": 1, "ior": 1.5 } }),
        ] {
            let scene = json!({
                "camera": { "position": [0.3, 1, 4], "look_at": [0, 0, 0] },
                "background": { "color": [1, 1, 1] },
                "objects": [{ "material": material, "shape": shape }]
            });
            let (mean, _) = estimate(&job(32, scene.clone()), 1024, 4);
            assert!(mean.iter().all(|&mean| (mean - 1.0).abs() < 4e-3), "{mean:?}: {scene}");
        }
    }
}

/// A floor under a ball that shines, in four ways: a light that only next-event estimation finds, one that scattered rays
/// find as well, an object that is sampled, and one that only scattered rays find.
#[test]
fn lights_agree_however_they_are_found() {
    let radiance = 5.0;
    let radius = 0.4;
    let color = radiance * radius * radius;
    let floor =
        |material: &Value| json!({ "material": material, "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } });
    let ball = |emission: Value| {
        json!({
            "material": { "surface": { "base_color": [0, 0, 0], "ior": 1, "emission": emission } },
            "shape": { "translate": { "by": [0.5, 1.1, 0.2], "child": { "sphere": { "radius": radius } } } }
        })
    };
    let light = |visible: bool| {
        json!([{ "sphere": {
            "position": [0.5, 1.1, 0.2], "radius": radius, "color": [color, color, color], "visible": visible
        } }])
    };
    let even =
        json!({ "checker": { "cell": 1, "colors": [[radiance, radiance, radiance], [radiance, radiance, radiance]] } });
    for material in [
        json!({ "diffuse": { "kd": [0.8, 0.5, 0.2] } }),
        json!({ "surface": { "base_color": [0.8, 0.5, 0.2], "roughness": 0.6 } }),
        json!({ "surface": { "base_color": [0.8, 0.5, 0.2], "roughness": 0.9, "metallic": 1 } }),
        json!({ "surface": { "base_color": [0.8, 0.5, 0.2], "roughness": 0.7, "clearcoat": 0.8, "clearcoat_roughness": 0.6 } }),
    ] {
        let scene = |lights: Value, objects: Vec<Value>| {
            let camera = json!({ "position": [0, 2, 2.5], "look_at": [0.2, 0, 0], "fov": 8 });
            job(0, json!({ "camera": camera, "lights": lights, "objects": objects }))
        };
        assert_equal(&[
            ("light alone", scene(light(false), vec![floor(&material)])),
            ("visible light", scene(light(true), vec![floor(&material)])),
            ("emitting object", scene(json!([]), vec![floor(&material), ball(json!([radiance, radiance, radiance]))])),
            ("scattered rays alone", scene(json!([]), vec![floor(&material), ball(even.clone())])),
        ]);
    }
}

/// A flat light and an object of the same radiance, thin enough to shine to one side as it does.
#[test]
fn flat_lights_have_the_radiance_of_an_object() {
    let (width, depth, radiance) = (1.2, 0.5, 4.0);
    let color = radiance * width * depth / std::f64::consts::PI;
    let floor = json!({ "material": { "diffuse": { "kd": [0.9, 0.6, 0.3] } }, "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } });
    let scene = |lights: Value, objects: Vec<Value>| {
        let camera = json!({ "position": [0, 2, 2.5], "look_at": [0.2, 0, 0], "fov": 8 });
        job(0, json!({ "camera": camera, "lights": lights, "objects": objects }))
    };
    let light = |visible: bool| {
        json!([{ "rectangle": {
            "position": [0.3, 1.5, -0.2], "direction": [0, -2, 0], "up": [0, 0, 1], "width": width, "height": depth,
            "color": [color, color, color], "visible": visible
        } }])
    };
    let slab = json!({
        "material": { "surface": { "base_color": [0, 0, 0], "ior": 1, "emission": [radiance, radiance, radiance] } },
        "shape": { "translate": { "by": [0.3, 1.505, -0.2], "child": { "box": { "size": [width, 0.01, depth] } } } }
    });
    assert_equal(&[
        ("light alone", scene(light(false), vec![floor.clone()])),
        ("visible light", scene(light(true), vec![floor.clone()])),
    ]);
    let (of_light, _) = estimate(&scene(light(true), vec![floor.clone()]), 1024, 16);
    let (of_object, _) = estimate(&scene(json!([]), vec![floor.clone(), slab]), 1024, 16);
    // The sides of the slab add about a hundredth.
    let ratio = of_object[0] / of_light[0];
    assert!((0.99..1.03).contains(&ratio), "{of_object:?} {of_light:?}");
    let disc = |visible: bool| {
        json!([{ "disc": {
            "position": [0.3, 1.5, -0.2], "direction": [0.2, -2, 0.1], "radius": 0.4, "color": [0.6, 0.5, 0.4],
            "visible": visible
        } }])
    };
    assert_equal(&[
        ("disc alone", scene(disc(false), vec![floor.clone()])),
        ("visible disc", scene(disc(true), vec![floor])),
    ]);
}

/// One of two lights is chosen for each sample.
#[test]
fn lights_add_up() {
    let lights = [
        json!({ "sphere": { "position": [0.5, 1.1, 0.2], "radius": 0.2, "color": [0.6, 0.5, 0.4] } }),
        json!({ "directional": { "direction": [1, 2, 0.5], "color": [0.3, 0.6, 0.2] } }),
        json!({ "spot": { "position": [0, 2, 0], "direction": [0.1, -1, 0.1], "color": [1, 1, 2] } }),
    ];
    let scene = |lights: &[Value]| {
        let floor = json!([{ "material": { "diffuse": { "kd": [0.9, 0.6, 0.3] } }, "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } }]);
        let camera = json!({ "position": [0, 2, 2.5], "look_at": [0.2, 0, 0], "fov": 4 });
        estimate(&job(2, json!({ "camera": camera, "lights": lights, "objects": floor })), 1024, 16)
    };
    let (all, deviation) = scene(&lights);
    for channel in 0..3 {
        let sum: f64 = lights.iter().map(|light| scene(std::slice::from_ref(light)).0[channel]).sum();
        assert!(
            (all[channel] - sum).abs() < 3.5 * deviation[channel] + 2e-3 * sum,
            "{all:?} ± {deviation:?}, not {sum}"
        );
    }
}

/// Without bounces and with matte surfaces, light is that of the default integrator: from lights and a day's sky.
#[test]
fn without_bounces_light_is_direct() {
    let matte = json!({ "diffuse": { "kd": [0.9, 0.6, 0.3], "ambient": [0, 0, 0] } });
    let objects = json!([
        { "material": matte, "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } },
        { "material": matte, "shape": { "translate": { "by": [0.6, 0.5, 0], "child": { "sphere": { "radius": 0.5 } } } } }
    ]);
    for background in [
        json!({ "day": { "sun": [0.8, 0.5, 0.4] } }),
        json!({ "day": { "sun": [-0.5, 0.1, 0.8], "turbidity": 6, "strength": 2 } }),
        json!({ "gradient": { "bottom": [0.2, 0.1, 0.3], "top": [0.9, 1, 2] } }),
    ] {
        let is_day = background.get("day").is_some();
        let mut lights = vec![json!({ "sky": { "strength": 1.5 } })];
        lights.extend(is_day.then(|| json!({ "sun": { "angle": 3 } })));
        let camera = json!({ "position": [0, 1, 2.5], "look_at": [0.1, 0, 0], "fov": 8 });
        let of_paths =
            job(0, json!({ "camera": camera, "background": background, "lights": lights, "objects": objects }));
        let mut direct = of_paths.clone();
        direct["scene"]["integrator"] = json!("direct");
        assert_equal(&[("direct", direct), ("path", of_paths)]);
    }
}

/// In a scene with glass, distances have no sign: a ray at a right angle to a wall still ends at the wall.
#[test]
fn rays_at_right_angles_do_not_pass_walls() {
    let scene = json!({ "scene": {
        "camera": { "position": [0, 0, 4], "look_at": [0, 0, 0] },
        "objects": [
            { "shape": { "translate": { "by": [0, 0, -1.05], "child": { "box": { "size": [2.2, 2.2, 0.1] } } } } },
            { "material": { "surface": { "transmission": 1 } },
              "shape": { "translate": { "by": [3, 0, 0], "child": { "sphere": { "radius": 0.1 } } } } }
        ] },
        "image": { "width": 9, "height": 9, "samples": 1, "format": "exr", "layers": ["depth"] } });
    for distance in 0..400 {
        let mut scene = scene.clone();
        scene["scene"]["camera"]["position"][2] = json!(1.5 + 0.013 * f64::from(distance));
        let job = parse(scene.to_string().as_bytes()).expect("valid");
        let at_frame = job.at(0).expect("a frame");
        let depth = f64::from(Integrator::new(&at_frame).layer_values(4.0_f32, 4.0).depth);
        assert!((depth - (2.5 + 0.013 * f64::from(distance))).abs() < 1e-4, "{depth} at {distance}");
    }
}

/// A floor below a pane of glass, lit from above.
fn under_glass(surface: &Value, light: &Value, straight: bool) -> Value {
    let mut job = job(
        6,
        json!({
            "camera": { "position": [2.5, -0.8, 0.3], "look_at": [0.1, -2, 0.1] },
            "lights": [light],
            "objects": [
                { "material": { "diffuse": { "kd": [0.8, 0.8, 0.8] } },
                  "shape": { "plane": { "normal": [0, 1, 0], "offset": -2 } } },
                { "material": { "surface": surface }, "shape": { "box": { "size": [3, 0.3, 3] } } }
            ]
        }),
    );
    job["scene"]["integrator"]["path"]["straight_shadows"] = json!(straight);
    job
}

#[test]
fn light_goes_straight_through_glass_if_wished() {
    // Glass that does not bend light: the same light, however it is found.
    let clear = json!({ "base_color": [0.9, 0.5, 0.3], "transmission": 1, "ior": 1, "roughness": 0 });
    for light in [
        json!({ "disc": { "position": [0.3, 2, 0], "direction": [0, -1, 0], "radius": 0.8, "color": [20, 20, 20], "visible": true } }),
        json!({ "sphere": { "position": [0.3, 2, 0], "radius": 0.7, "color": [20, 20, 20], "visible": true } }),
    ] {
        let jobs = [false, true].map(|straight| under_glass(&clear, &light, straight));
        let [bent, straight] = jobs;
        assert_equal(&[("found by chance", bent), ("found straight", straight)]);
    }
    // Two surfaces that reflect a twenty-fifth each, and the color of the glass.
    let glass = json!({ "base_color": [0.9, 0.5, 0.3], "transmission": 1, "ior": 1.5, "roughness": 0 });
    let sun = json!({ "directional": { "direction": [0, 1, 0], "color": [2, 2, 2] } });
    let through = |filter: f64| 0.8 * 2.0 * 0.96_f64.powi(2) * filter;
    let job = under_glass(&glass, &sun, true);
    let mut direct = job.clone();
    direct["scene"]["integrator"]["path"]["max_bounces"] = json!(0);
    assert_is(&direct, [through(0.9), through(0.5), through(0.3)]);
    let (lit, _) = estimate(&job, 256, 8);
    let (dark, _) = estimate(&under_glass(&glass, &sun, false), 256, 8);
    assert!(lit[0] > 5.0 * dark[0], "{lit:?} {dark:?}");
}
