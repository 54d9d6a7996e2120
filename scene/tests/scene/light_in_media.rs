//! Path tracing of media: known transmittances, no lost light, and agreement of estimators.

#![expect(clippy::disallowed_methods, reason = "expected values are computed in f64 by std's functions")]

use serde_json::{Value, json};

use crate::light::{assert_equal, assert_is, estimate, job};

/// A ball of a medium of radius 1, seen by a narrow view through its center.
fn ball(medium: &Value, more: Value) -> Value {
    let mut scene = json!({
        "camera": { "position": [0, 0, 4], "look_at": [0, 0, 0], "fov": 0.1 },
        "objects": [{ "material": medium, "shape": { "sphere": { "radius": 1 } } }]
    });
    let Value::Object(more) = more else { panic!("members of a scene") };
    scene.as_object_mut().expect("an object").extend(more);
    scene
}

#[test]
fn what_absorbs_transmits_as_beer_and_lambert_say() {
    let white = || json!({ "background": { "color": [1, 1, 1] } });
    let black = |more: Value| {
        let mut volume = json!({ "density": 0.7, "albedo": [0, 0, 0] });
        volume.as_object_mut().expect("members").extend(more.as_object().expect("members").clone());
        json!({ "volume": volume })
    };
    assert_is(&job(4, ball(&black(json!({})), white())), [(-1.4_f64).exp(); 3]);
    // The density rises to the center.
    assert_is(&job(4, ball(&black(json!({ "edge": 1 })), white())), [(-0.7_f64).exp(); 3]);
    // A medium that glows and absorbs: emission · (1 − transmittance).
    let glows = black(json!({ "emission": [2, 1, 0.5] }));
    let share = 1.0 - (-1.4_f64).exp();
    assert_is(&job(0, ball(&glows, json!({}))), [2.0 * share, share, 0.5 * share]);
}

#[test]
fn light_reaches_a_floor_through_what_absorbs() {
    let scene = |media: Value| {
        let mut objects = vec![json!({ "material": { "diffuse": { "kd": [0.8, 0.8, 0.8] } },
            "shape": { "plane": { "normal": [0, 1, 0], "offset": -2 } } })];
        objects.extend(media.as_array().expect("objects").clone());
        json!({ "camera": { "position": [0, -1.5, 4], "look_at": [0, -2, 0], "fov": 0.1 }, "objects": objects,
            "lights": [{ "point": { "position": [0, 3, 0], "color": [9, 9, 9] } }] })
    };
    let medium = json!({ "volume": { "density": 0.7, "albedo": [0, 0, 0] } });
    let shaded = json!([{ "material": medium, "shape": { "sphere": { "radius": 1 } } }]);
    let (clear, _) = estimate(&job(0, scene(json!([]))), 16, 1);
    assert_is(&job(0, scene(shaded)), clear.map(|clear| clear * (-1.4_f64).exp()));
}

#[test]
fn what_scatters_all_light_vanishes_in_a_white_sky() {
    for medium in [
        json!({ "volume": { "density": 1.5, "albedo": [1, 1, 1] } }),
        json!({ "volume": { "density": 3, "albedo": [1, 1, 1], "anisotropy": 0.8, "edge": 0.5 } }),
        json!({ "volume": { "density": 2, "albedo": [1, 1, 1], "anisotropy": -0.5,
            "noise": { "perlin": { "scale": 3, "octaves": 2 } } } }),
        json!({ "clouds": { "density": 3, "color": [1, 1, 1], "noise": { "perlin": { "scale": 2, "octaves": 2 } } } }),
    ] {
        let scene = ball(&medium, json!({ "background": { "color": [1, 1, 1] } }));
        let (mean, _) = estimate(&job(32, scene), 1024, 4);
        assert!(mean.iter().all(|&mean| (mean - 1.0).abs() < 2e-3), "{mean:?}: {medium}");
    }
}

/// A glass shape and a medium in the same shape: subsurface scattering.
#[test]
fn what_scatters_all_light_under_a_glass_skin_vanishes_in_a_white_sky() {
    let skin = json!({ "surface": { "base_color": [1, 1, 1], "roughness": 0, "transmission": 1, "ior": 1.1 } });
    for anisotropy in [0.0, 0.6] {
        let medium = json!({ "volume": { "density": 1.5, "albedo": [1, 1, 1], "anisotropy": anisotropy } });
        let mut scene = ball(&medium, json!({ "background": { "color": [1, 1, 1] } }));
        scene["objects"]
            .as_array_mut()
            .expect("objects")
            .push(json!({ "material": skin, "shape": { "sphere": { "radius": 1 } } }));
        let (mean, deviation) = estimate(&job(32, scene.clone()), 1024, 8);
        // Paths of more than 32 bounces are cut off.
        assert!(mean.iter().all(|&mean| (mean - 1.0).abs() < 6e-3), "{mean:?} ± {deviation:?}");
        // It is no clear glass: little of a light of radiance 1 behind it is seen.
        scene["background"] = json!({ "color": [0, 0, 0] });
        scene["lights"] = json!([{ "disc": { "position": [0, 0, -9], "direction": [0, 0, 1], "radius": 0.2,
            "color": [0.04, 0.04, 0.04], "visible": true } }]);
        let (seen, _) = estimate(&job(32, scene), 1024, 8);
        assert!((seen[0] - (-3.0_f64).exp()).abs() < 0.01, "{seen:?}");
    }
}

#[test]
fn media_are_lit_alike_however_lights_are_found() {
    for anisotropy in [0.0, 0.7, -0.4] {
        let medium = json!({ "volume": { "density": 1.2, "albedo": [0.9, 0.7, 0.4], "anisotropy": anisotropy } });
        let radiance = 5.0;
        let (radius, at) = (0.8, [1.5, 1.8, 0.5]);
        let color = radiance * radius * radius;
        let light = |visible: bool| {
            let sphere =
                json!({ "position": at, "radius": radius, "color": [color, color, color], "visible": visible });
            json!({ "lights": [{ "sphere": sphere }] })
        };
        let mut shining = ball(&medium, json!({}));
        shining["objects"].as_array_mut().expect("objects").push(json!({
            "material": { "surface": { "base_color": [0, 0, 0], "ior": 1, "emission": [radiance, radiance, radiance] } },
            "shape": { "translate": { "by": at, "child": { "sphere": { "radius": radius } } } }
        }));
        assert_equal(&[
            ("light alone", job(3, ball(&medium, light(false)))),
            ("visible light", job(3, ball(&medium, light(true)))),
            ("emitting object", job(3, shining)),
        ]);
    }
}

#[test]
fn one_scattering_is_that_of_direct_light() {
    let medium = json!({ "volume": { "density": 0.8, "albedo": [0.9, 0.6, 0.3], "anisotropy": 0.4, "edge": 0.3,
        "steps": 512, "light_steps": 64 } });
    let lights = || json!({ "lights": [{ "point": { "position": [1.5, 2, 1], "color": [9, 9, 9] } }] });
    let mut direct = job(0, ball(&medium, lights()));
    direct["scene"]["integrator"] = json!("direct");
    let (wanted, _) = estimate(&direct, 16, 1);
    let (mean, deviation) = estimate(&job(0, ball(&medium, lights())), 1024, 24);
    for channel in 0..3 {
        // The steps of direct light are not exact.
        let tolerance = 3.0 * deviation[channel] + 0.005 * wanted[channel];
        assert!((mean[channel] - wanted[channel]).abs() < tolerance, "{mean:?} ± {deviation:?}, not {wanted:?}");
        assert!(deviation[channel] < 0.02 * wanted[channel], "{mean:?} ± {deviation:?} says nothing");
    }
}
