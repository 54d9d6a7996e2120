//! Soft shadows against geometry: the visible fraction of a light past a straight edge.

#![expect(clippy::disallowed_methods, reason = "expected values are computed in f64 by std's functions")]

use std::f64::consts::PI;

use scene::{Integrator, Job};

/// Width of the picture; the tolerance of a hit is a fraction of a pixel, so pixels must be small compared to the
/// penumbra.
const WIDTH_PX: u32 = 1280;
const STRIDE_PX: usize = 32;
/// Rows with the same light.
const ROWS: u32 = 8;
/// Height of the edge above the floor, in scene units.
const EDGE: f64 = 2.0;
/// Width of the picture, in scene units.
const SEEN: f64 = 1.2;

/// A floor seen from under a slab that covers x < 0, lit from above.
fn job(light: &str, samples: u32) -> Job {
    let text = format!(
        r#"{{ "scene": {{
            "camera": {{ "position": [0, 1.5, 0], "look_at": [0, 0, 0], "up": [0, 0, -1],
                "projection": {{ "orthographic": {{ "height": {} }} }} }},
            "lights": [{light}],
            "materials": {{ "white": {{ "diffuse": {{ "kd": [1, 1, 1], "ambient": [0, 0, 0] }} }} }},
            "objects": [
                {{ "material": "white", "shape": {{ "plane": {{ "normal": [0, 1, 0], "offset": 0 }} }} }},
                {{ "material": "white", "shape": {{ "translate": {{ "by": [-10, {}, 0],
                    "child": {{ "box": {{ "size": [20, 0.01, 40] }} }} }} }} }} ] }},
        "image": {{ "width": {WIDTH_PX}, "height": {ROWS}, "samples": {samples} }} }}"#,
        SEEN * f64::from(ROWS) / f64::from(WIDTH_PX),
        EDGE + 0.005,
    );
    scene::parse(text.as_bytes()).unwrap_or_else(|fault| panic!("{fault:?}"))
}

/// Sampled x coordinates, and the light on the floor there, averaged over the rows.
fn floor(light: &str, samples: u32) -> Vec<(f64, f64)> {
    let job = job(light, samples);
    let at_frame = job.at(0).expect("a still job");
    let program = Integrator::new(&at_frame);
    (0..WIDTH_PX)
        .step_by(STRIDE_PX)
        .map(|x| {
            let place = (f64::from(x) + 0.5) / f64::from(WIDTH_PX) - 0.5;
            let light = (0..ROWS).map(|y| f64::from(program.pixel(x as f32, y as f32).color.y));
            (place * SEEN, light.sum::<f64>() / f64::from(ROWS))
        })
        .collect()
}

/// Fraction of a disk of radius 1 on one side of a line at `s` from its center.
fn share_of_disc(s: f64) -> f64 {
    let s = s.clamp(-1.0, 1.0);
    1.0 - (s.acos() - s * (1.0 - s * s).sqrt()) / PI
}

/// Maximum difference, as a fraction of the full light, from the fraction of a disk past a line; `reach` is the
/// distance of the penumbra's edge from the shadow's center.
fn difference(light: &str, samples: u32, reach: f64) -> f64 {
    let floor = floor(light, samples);
    // At the end of the penumbra: farther away, a light with a position is also more distant.
    let (_, whole) = *floor.iter().find(|(x, _)| *x > reach).expect("a place in full light");
    assert!(whole > 0.1 && floor[0].1 == 0.0, "from light to shadow: {floor:?}");
    let differences = floor.iter().map(|(x, light)| (light / whole - share_of_disc(x / reach)).abs());
    differences.fold(0.0, f64::max)
}

/// The difference falls as the root of the number of samples: the bound is four standard deviations of that number of
/// binary samples, plus the picture's own precision.
fn assert_converges(light: &str, reach: f64) {
    for samples in [16, 256, 4096] {
        let deviation = (0.25 / f64::from(samples * ROWS)).sqrt();
        let difference = difference(light, samples, reach);
        assert!(difference < 4.0 * deviation + 0.002, "{samples} samples: {difference}");
    }
}

#[test]
fn a_wide_sun_casts_the_penumbra_of_its_disk() {
    let half_angle: f64 = 5.0;
    let light = r#"{ "directional": { "direction": [0, 1, 0], "angle": 10, "color": [1, 1, 1] } }"#;
    assert_converges(light, EDGE * half_angle.to_radians().tan());
}

#[test]
fn a_sphere_light_casts_the_penumbra_of_its_disk() {
    // The edge is half as far from the floor as from the light: its image on the light moves twice as far as on the
    // floor.
    let light = r#"{ "sphere": { "position": [0, 6, 0], "radius": 0.4, "color": [36, 36, 36] } }"#;
    assert_converges(light, 0.4 * EDGE / (6.0 - EDGE));
}

#[test]
fn a_wall_takes_half_of_the_skys_light_from_a_floor() {
    // Rays into the corner are between two surfaces that meet ahead, and run out of steps.
    let text = r#"{ "scene": {
        "camera": { "position": [0, 1, 0], "look_at": [0, 0, 0], "up": [0, 0, -1],
            "projection": { "orthographic": { "height": 0.4 } } },
        "background": { "color": [1, 1, 1] }, "lights": [{ "sky": {} }],
        "materials": { "white": { "diffuse": { "kd": [1, 1, 1], "ambient": [0, 0, 0] } } },
        "objects": [
            { "material": "white", "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } },
            { "material": "white", "shape": { "plane": { "normal": [0, 0, 1], "offset": -0.5 } } } ] },
        "image": { "width": 8, "height": 8, "samples": 1024 } }"#;
    let job = scene::parse(text.as_bytes()).unwrap_or_else(|fault| panic!("{fault:?}"));
    let at_frame = job.at(0).expect("a still job");
    let program = Integrator::new(&at_frame);
    let pixels = (0..64_u16).map(|index| program.pixel(f32::from(index % 8), f32::from(index / 8)).color.y);
    let mean = pixels.map(f64::from).sum::<f64>() / 64.0;
    // 0.5055 where rays without steps left count as unoccluded.
    assert!((mean - 0.5).abs() < 0.002, "{mean}");
}
