//! The physically based material against its own mathematics: energy, reciprocity, edges, sampling.
//!
//! Expected values are computed here in `f64`, from the published formulas and by another quadrature.

#![expect(clippy::disallowed_methods, reason = "expected values are computed in f64 by std's functions")]

use std::f64::consts::{PI, TAU};

use scene::lights::LightSample;
use scene::materials::microfacet::{alpha_from_roughness, orthonormal_basis, sample_visible_normal, smith_g2_over_g1};
use scene::materials::{IncidentLight, Material, ShadingPoint};
use scene::real::{MaskValue, Vec3, vec3};

type V = [f64; 3];

const ROUGHNESSES: [f64; 6] = [0.05, 0.15, 0.3, 0.5, 0.75, 1.0];
const COSINES: [f64; 7] = [1.0, 0.9, 0.7, 0.5, 0.3, 0.1, 0.02];

fn dot(a: V, b: V) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn normalize(v: V) -> V {
    let length = dot(v, v).sqrt();
    v.map(|c| c / length)
}

fn at_cosine(cosine: f64) -> V {
    [(1.0 - cosine * cosine).sqrt(), 0.0, cosine]
}

/// Direction of reflection by a mirror with this normal.
fn mirrored(v: V, h: V) -> V {
    let twice = 2.0 * dot(v, h);
    [twice * h[0] - v[0], twice * h[1] - v[1], twice * h[2] - v[2]]
}

fn single(v: V) -> Vec3<f32> {
    vec3(v[0] as f32, v[1] as f32, v[2] as f32)
}

fn surface(parameters: &str) -> Material {
    serde_json::from_str(&format!(r#"{{ "surface": {{ {parameters} }} }}"#)).unwrap()
}

/// A shading point whose normal is +z.
fn place(to_viewer: V) -> ShadingPoint<f32> {
    let normal = vec3(0.0, 0.0, 1.0);
    let point = vec3(0.1, 0.2, 0.3);
    ShadingPoint {
        normal,
        to_viewer: single(to_viewer),
        local_point: point,
        local_normal: normal,
        camera_t: 3.0,
        footprint: [single([0.0; 3]); 2],
        is_inside: MaskValue(false),
    }
}

/// π·BRDF·cosine of a material, in its red channel.
fn answer(material: &Material, to_viewer: V, to_light: V) -> f64 {
    let light = LightSample { direction: single(to_light), radiance: vec3(1.0, 1.0, 1.0) };
    let lighting = IncidentLight { lights: vec![light], ambient: None, ambient_visibility: None, shadow: None };
    f64::from(material.shade(&place(to_viewer), &lighting).x)
}

/// The published GGX density of half vectors D·cosine.
fn density_of_normals(alpha: f64, cosine: f64) -> f64 {
    let width = cosine * cosine * (alpha * alpha - 1.0) + 1.0;
    alpha * alpha * cosine / (PI * width * width)
}

/// Directions of light and their weights, evenly spread over `steps`² cells, by half vectors of one roughness or,
/// without one, by the cosine.
fn directions(to_viewer: V, alpha: Option<f64>, steps: u32) -> impl Iterator<Item = V> {
    (0..steps * steps).filter_map(move |cell| {
        let (u, v) = (f64::from(cell / steps) + 0.5, f64::from(cell % steps) + 0.5);
        let (u, angle) = (u / f64::from(steps), v / f64::from(steps) * TAU);
        let polar = |cosine: f64| {
            let sine = (1.0 - cosine * cosine).sqrt();
            [sine * angle.cos(), sine * angle.sin(), cosine]
        };
        let light = match alpha {
            None => polar((1.0 - u).sqrt()),
            Some(alpha) => mirrored(to_viewer, polar((1.0 / (1.0 + alpha * alpha * u / (1.0 - u))).sqrt())),
        };
        (light[2] > 0.0).then_some(light)
    })
}

/// Density of [`directions`] at one of them.
fn density(to_viewer: V, to_light: V, alpha: Option<f64>) -> f64 {
    let Some(alpha) = alpha else { return to_light[2] / PI };
    let half = normalize([0, 1, 2].map(|i| to_viewer[i] + to_light[i]));
    density_of_normals(alpha, half[2]) / (4.0 * dot(to_viewer, half))
}

/// Fraction of ambient light that a material reflects: the integral of [`answer`] over the hemisphere, divided by π,
/// by several sets of directions weighted by the balance heuristic.
fn furnace(material: &Material, to_viewer: V, alphas: &[f64], steps: u32) -> f64 {
    let sets: Vec<Option<f64>> = alphas.iter().copied().map(Some).chain([None]).collect();
    let count = f64::from(steps * steps);
    let sum: f64 = sets
        .iter()
        .flat_map(|&set| directions(to_viewer, set, steps))
        .map(|light| {
            let together: f64 = sets.iter().map(|&set| density(to_viewer, light, set)).sum();
            answer(material, to_viewer, light) / (PI * together)
        })
        .sum();
    sum / count
}

/// F0 of a dielectric with this index of refraction.
fn reflectance(ior: f64) -> f64 {
    ((ior - 1.0) / (ior + 1.0)).powi(2)
}

fn schlick(f0: f64, cosine: f64) -> f64 {
    f0 + (1.0 - f0) * (1.0 - cosine).powi(5)
}

/// Smith's Λ for GGX: Heitz 2014, equations 72 and 99.
fn lambda(alpha: f64, cosine: f64) -> f64 {
    let tangent_squared = 1.0 / (cosine * cosine) - 1.0;
    f64::midpoint(-1.0, (1.0 + alpha * alpha * tangent_squared).sqrt())
}

/// Ambient light reflected by single scattering, for this F0, by half vectors over the full hemisphere of normals in
/// slope space.
fn single_scattering(f0: f64, alpha: f64, to_viewer: V) -> f64 {
    const STEPS: u32 = 400;
    let mut sum = 0.0;
    for cell in 0..STEPS * STEPS {
        // Angles of the half vector, closer together near the normal.
        let (u, v) = (f64::from(cell / STEPS) + 0.5, f64::from(cell % STEPS) + 0.5);
        let (u, azimuth) = (u / f64::from(STEPS), v / f64::from(STEPS) * TAU);
        let tangent = alpha * u / (1.0 - u);
        let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
        let sine = tangent * cosine;
        let half = [sine * azimuth.cos(), sine * azimuth.sin(), cosine];
        let light = mirrored(to_viewer, half);
        let across = dot(to_viewer, half);
        if light[2] <= 0.0 || across <= 0.0 {
            continue;
        }
        // dω of the half vector: sine·dθ·dφ, with dθ = cosine²·d(tangent).
        let solid = sine * cosine * cosine * alpha / ((1.0 - u) * (1.0 - u)) * TAU / f64::from(STEPS * STEPS);
        let shadowed = 1.0 / (1.0 + lambda(alpha, light[2]) + lambda(alpha, to_viewer[2]));
        let normals = density_of_normals(alpha, cosine) / cosine;
        // D·G₂·F/(4·nl·nv)·nl over dω of the light, which is 4·(v·h) times that of the half vector.
        sum += normals * shadowed * schlick(f0, across) * across / to_viewer[2] * solid;
    }
    sum
}

fn alpha_of(roughness: f64) -> f64 {
    f64::from(alpha_from_roughness(roughness as f32))
}

#[test]
fn a_metal_loses_only_multiple_scattering() {
    for roughness in ROUGHNESSES {
        let metal = surface(&format!(r#""base_color": [1, 1, 1], "metallic": 1, "roughness": {roughness}"#));
        let alpha = alpha_of(roughness);
        for cosine in COSINES {
            let viewer = at_cosine(cosine);
            let (got, want) = (furnace(&metal, viewer, &[alpha], 160), single_scattering(1.0, alpha, viewer));
            assert!((got - want).abs() <= 0.005, "{got} for {want} at roughness {roughness}, cosine {cosine}");
            assert!(got <= 1.005, "{got} of 1 at roughness {roughness}, cosine {cosine}");
        }
    }
}

#[test]
fn a_white_dielectric_reflects_all_entering_light() {
    for (roughness, ior) in ROUGHNESSES.into_iter().flat_map(|roughness| [(roughness, 1.5), (roughness, 2.4)]) {
        let body = surface(&format!(r#""base_color": [1, 1, 1], "roughness": {roughness}, "ior": {ior}"#));
        let (alpha, f0) = (alpha_of(roughness), reflectance(ior));
        for cosine in COSINES {
            let viewer = at_cosine(cosine);
            let got = furnace(&body, viewer, &[alpha], 160);
            // All light that enters is scattered out again; the reflected light is single scattering's.
            let want = (1.0 - schlick(f0, cosine)) + single_scattering(f0, alpha, viewer);
            assert!((got - want).abs() <= 0.005, "{got} for {want} at {roughness}, {ior}, cosine {cosine}");
            assert!(got <= 1.005, "{got} of 1 at roughness {roughness}, ior {ior}, cosine {cosine}");
        }
    }
}

#[test]
fn no_mixture_of_lobes_reflects_more_than_arrives() {
    for (metallic, coat, coat_roughness) in [(0.0, 1.0, 0.1), (1.0, 1.0, 0.3), (0.5, 0.5, 1.0), (0.5, 0.0, 0.0)] {
        for roughness in ROUGHNESSES {
            let mixed = surface(&format!(
                r#""base_color": [1, 1, 1], "metallic": {metallic}, "roughness": {roughness},
                   "clearcoat": {coat}, "clearcoat_roughness": {coat_roughness}"#
            ));
            for cosine in COSINES {
                let alphas = [alpha_of(roughness), alpha_of(coat_roughness)];
                let got = furnace(&mixed, at_cosine(cosine), &alphas, 100);
                assert!(got <= 1.005, "{got} of 1: {metallic}, {roughness}, {coat}, cosine {cosine}");
            }
        }
    }
}

#[test]
fn a_clear_coat_on_white_loses_only_multiple_scattering() {
    for (roughness, cosine) in [0.3, 1.0].into_iter().flat_map(|roughness| COSINES.map(|cosine| (roughness, cosine))) {
        let coated = surface(&format!(
            r#""base_color": [1, 1, 1], "ior": 1, "roughness": {roughness}, "clearcoat": 1, "clearcoat_roughness": {roughness}"#
        ));
        let (alpha, viewer) = (alpha_of(roughness), at_cosine(cosine));
        let got = furnace(&coated, viewer, &[alpha], 160);
        let at_most = (1.0 - schlick(0.04, cosine)) + single_scattering(0.04, alpha, viewer);
        assert!(got <= at_most + 0.005, "{got} above {at_most} at {roughness}, cosine {cosine}");
    }
}

#[test]
fn ambient_light_equals_the_sum_over_directions() {
    for coat in [0.0, 1.0] {
        // A smooth boundary and clear coat: their highlights have no effect because they are too small for the
        // directions by cosine.
        let parameters = |ks: &str| format!(r#""base_color": [0.6, 0.6, 0.6], "clearcoat": {coat}{ks}"#);
        let material = surface(&parameters(r#", "roughness": 1"#));
        let none = surface(&parameters(r#", "roughness": 1, "transmission": 1"#));
        for cosine in COSINES {
            let viewer = at_cosine(cosine);
            let body: f64 = directions(viewer, None, 200)
                .map(|light| (answer(&material, viewer, light) - answer(&none, viewer, light)) / light[2])
                .sum::<f64>()
                / 40_000.0;
            let around = IncidentLight {
                ambient: Some(vec3(1.0, 1.0, 1.0)),
                lights: Vec::new(),
                ambient_visibility: None,
                shadow: None,
            };
            let got = f64::from(material.shade(&place(viewer), &around).x);
            assert!((got - body).abs() < 1e-3, "{got} for {body}, coat {coat}, cosine {cosine}");
        }
    }
}

#[test]
fn light_and_viewer_may_be_exchanged() {
    let materials = [
        r#""roughness": 0.3"#,
        r#""metallic": 1, "roughness": 0.6"#,
        r#""metallic": 0.4, "roughness": 0.2, "clearcoat": 0.8, "clearcoat_roughness": 0.4, "transmission": 0.3"#,
    ]
    .map(surface);
    for (a, b) in COSINES.into_iter().flat_map(|a| COSINES.map(|b| (a, b))) {
        for azimuth in [0.1_f64, 1.0, 2.0, 3.0, PI - 1e-3] {
            let rotated = at_cosine(b);
            let (one, other) = (at_cosine(a), [rotated[0] * azimuth.cos(), rotated[0] * azimuth.sin(), b]);
            for material in &materials {
                let there = answer(material, one, other) / b;
                let back = answer(material, other, one) / a;
                assert!(
                    (there - back).abs() <= 1e-4 * there.max(back) + 1e-6,
                    "{there} and {back} at {a}, {b}, {azimuth}"
                );
            }
        }
    }
}

#[test]
fn grazing_directions_give_finite_light() {
    let heights = [0.0, 1e-30, 1e-12, 1e-7, 1e-4, 1e-2, 0.3, 1.0];
    for roughness in [0.0, 1e-3, 0.04, 0.2, 0.6, 1.0] {
        let materials = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(metallic, coat)| {
            surface(&format!(
                r#""roughness": {roughness}, "metallic": {metallic}, "clearcoat": {coat}, "clearcoat_roughness": {roughness}"#
            ))
        });
        for (a, b) in heights.into_iter().flat_map(|a| heights.map(|b| (a, b))) {
            for azimuth in [0.0_f64, 1e-6, 1.0, PI / 2.0, PI - 1e-6, PI] {
                let rotated = at_cosine(b);
                let light = [rotated[0] * azimuth.cos(), rotated[0] * azimuth.sin(), b];
                for (material, below) in materials.iter().flat_map(|material| [(material, 1.0), (material, -1.0)]) {
                    let got = answer(material, at_cosine(a), [light[0], light[1], light[2] * below]);
                    assert!(got.is_finite() && got >= 0.0, "{got} at {a}, {b}, {azimuth}, roughness {roughness}");
                }
            }
        }
    }
}

#[test]
fn sampled_visible_normals_match_their_density() {
    // Mean of some functions over the density G₁·max(v·h, 0)·D/(n·v), Heitz 2018, compared with that of samples.
    const STEPS: u32 = 256;
    let functions: [fn(V) -> f64; 4] = [|h| h[0], |h| h[2], |h| h[0] * h[0], |h| h[1] * h[1]];
    for (roughness, cosine) in [0.3, 0.6, 1.0].into_iter().flat_map(|r| [1.0, 0.6, 0.2, 0.05].map(|c| (r, c))) {
        let (alpha, viewer) = (alpha_of(roughness), at_cosine(cosine));
        let (mut sampled, mut expected, mut whole) = ([0.0; 4], [0.0; 4], 0.0);
        for cell in 0..STEPS * STEPS {
            let (u, v) = (f64::from(cell / STEPS) + 0.5, f64::from(cell % STEPS) + 0.5);
            let (u, v) = (u / f64::from(STEPS), v / f64::from(STEPS));
            let normal = sample_visible_normal(single(viewer), alpha as f32, u as f32, v as f32);
            assert!(normal.z >= 0.0 && (normal.length() - 1.0).abs() < 1e-5, "{normal:?}");
            let normal = <[f32; 3]>::from(normal).map(f64::from);
            assert!(dot(normal, viewer) > -1e-5, "the viewer does not see {normal:?}");

            let tangent = alpha * u / (1.0 - u);
            let high = 1.0 / (1.0 + tangent * tangent).sqrt();
            let (wide, azimuth) = (tangent * high, v * TAU);
            let half = [wide * azimuth.cos(), wide * azimuth.sin(), high];
            let solid = wide * high * high * alpha / ((1.0 - u) * (1.0 - u)) * TAU / f64::from(STEPS * STEPS);
            let masked = 1.0 / (1.0 + lambda(alpha, cosine));
            let weight =
                masked * dot(viewer, half).max(0.0) * density_of_normals(alpha, high) / (high * cosine) * solid;
            whole += weight;
            for (index, function) in functions.iter().enumerate() {
                sampled[index] += function(normal) / f64::from(STEPS * STEPS);
                expected[index] += function(half) * weight;
            }
        }
        assert!((whole - 1.0).abs() < 2e-3, "the density's integral is {whole} at {roughness}, {cosine}");
        for (got, want) in sampled.into_iter().zip(expected) {
            assert!((got - want).abs() < 3e-3, "{got} for {want} at roughness {roughness}, cosine {cosine}");
        }
    }
}

#[test]
fn reflected_samples_sum_to_single_scattering() {
    const STEPS: u32 = 200;
    for (roughness, cosine) in ROUGHNESSES.into_iter().flat_map(|r| COSINES.map(|c| (r, c))) {
        let (alpha, viewer) = (alpha_of(roughness), at_cosine(cosine));
        let mut sum = 0.0;
        for cell in 0..STEPS * STEPS {
            let (u, v) = (f64::from(cell / STEPS) + 0.5, f64::from(cell % STEPS) + 0.5);
            let (u, v) = (u / f64::from(STEPS), v / f64::from(STEPS));
            let normal = sample_visible_normal(single(viewer), alpha as f32, u as f32, v as f32);
            let light = mirrored(viewer, <[f32; 3]>::from(normal).map(f64::from));
            if light[2] > 0.0 {
                sum += f64::from(smith_g2_over_g1(alpha as f32, light[2] as f32, cosine as f32));
            }
        }
        let (got, want) = (sum / f64::from(STEPS * STEPS), single_scattering(1.0, alpha, viewer));
        assert!((got - want).abs() < 5e-3, "{got} for {want} at roughness {roughness}, cosine {cosine}");
    }
}

#[test]
fn a_frame_has_three_orthogonal_directions() {
    for normal in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.6, -0.64, -0.48], [1e-4, -1e-4, -1.0]] {
        let normal = single(normalize(normal));
        let (x, y) = orthonormal_basis(normal);
        for (a, b, want) in [(x, x, 1.0), (y, y, 1.0), (x, y, 0.0), (x, normal, 0.0), (y, normal, 0.0)] {
            assert!((a.dot(b) - want).abs() < 1e-6, "{x:?}, {y:?}, {normal:?}");
        }
        assert!((x.cross(y) - normal).length() < 1e-6);
    }
}
