//! Tests of the rays of a lens against the geometry of thin lenses.

use super::super::{Camera, View};
use super::*;
use crate::real::vec3;

/// Directions and a distance of a camera that looks aslant.
const ASLANT: &str = r#""position": [3, 2, 5], "look_at": [-1, 0.5, 0], "up": [0.3, 1, 0]"#;
const WIDTH: u32 = 200;
const HEIGHT: u32 = 100;

fn view(camera: &str) -> View {
    serde_json::from_str::<Camera>(&format!("{{ {camera} }}"))
        .unwrap_or_else(|error| panic!("{error}: {camera}"))
        .view(WIDTH, HEIGHT)
}

/// Views of each projection with a lens, aslant.
fn views(lens: &str) -> Vec<View> {
    ["\"fov\": 35", "\"projection\": { \"orthographic\": { \"height\": 3 } }"]
        .map(|projection| view(&format!("{ASLANT}, {projection}, \"lens\": {lens}")))
        .to_vec()
}

/// Pairs of numbers, spread evenly, with those at the ends of their range.
fn pairs(edge: u32) -> impl Iterator<Item = (f32, f32)> + Clone {
    let along = move |index: u32| if index + 1 == edge { 1.0 - f32::EPSILON / 2.0 } else { index as f32 / edge as f32 };
    (0..edge * edge).map(move |index| (along(index % edge), along(index / edge)))
}

/// Where a ray meets the plane at a distance along the view.
fn at_depth(view: &View, ray: &Ray<f32>, depth: f32) -> Vec3<f32> {
    let start = (ray.origin - view.origin()).dot(view.forward);
    ray.at((depth - start) / ray.direction.dot(view.forward))
}

/// Greatest distance between two of some points.
fn width(points: &[Vec3<f32>]) -> f32 {
    let apart = |one: &Vec3<f32>| points.iter().map(|other| (*one - *other).length()).fold(0.0, f32::max);
    points.iter().map(apart).fold(0.0, f32::max)
}

#[test]
fn all_rays_of_a_point_of_the_picture_meet_in_the_plane_of_focus() {
    for shape in ["\"blades\": 0", "\"blades\": 7, \"turn\": 20"] {
        for view in views(&format!(r#"{{ "aperture": 0.8, "focus": 4, {shape} }}"#)) {
            for (x, y) in [(0.0, 0.0), (100.0, 50.0), (31.5, 88.5), (200.0_f32, 3.5)] {
                let wanted = at_depth(&view, &view.ray(x, y), 4.0);
                for pair in pairs(16) {
                    let ray = view.ray_through_lens(x, y, || pair);
                    let off = (at_depth(&view, &ray, 4.0) - wanted).length();
                    assert!(off < 1e-5, "{shape}, {pair:?}: {off} beside the point in focus");
                    assert!((ray.direction.length() - 1.0).abs() < 1e-6);
                    // It starts on the disc of the lens, around the start of the ray through its center.
                    let from_center = ray.origin - view.ray(x, y).origin;
                    assert!(from_center.dot(view.forward).abs() < 1e-6 && from_center.length() < 0.400_001);
                }
            }
        }
    }
}

#[test]
fn the_circle_of_confusion_is_as_wide_as_that_of_a_thin_lens() {
    let (aperture, focus) = (0.8, 4.0);
    for view in views(r#"{ "f_stop": 2.5, "focal_length": 2, "focus": 4 }"#) {
        for depth in [0.0, 1.0, 3.0, 4.5, 10.0, 60.0_f32] {
            let points: Vec<_> =
                pairs(24).map(|pair| at_depth(&view, &view.ray_through_lens(77.0, 20.0, || pair), depth)).collect();
            let wanted = aperture * (depth - focus).abs() / focus;
            let got = width(&points);
            assert!((got - wanted).abs() < 0.01 * wanted, "at {depth}: {got} instead of {wanted}");
        }
    }
}

#[test]
fn the_plane_through_a_point_is_in_focus() {
    let ahead = view(&format!("{ASLANT}, \"lens\": {{ \"aperture\": 0.8, \"focus\": [0, 0, 0] }}"));
    let wanted = (vec3(0.0, 0.0, 0.0) - ahead.origin()).dot(ahead.forward);
    let points: Vec<_> =
        pairs(8).map(|pair| at_depth(&ahead, &ahead.ray_through_lens(9.0, 9.0, || pair), wanted)).collect();
    assert!(wanted > 3.0 && width(&points) < 1e-5, "{wanted}: {points:?}");
}

/// Points of an aperture of radius 1, as seen in the picture.
fn points_of(shape: &str, pairs: impl Iterator<Item = (f32, f32)>) -> Vec<(f32, f32)> {
    let view = view(&format!(
        r#""position": [0, 0, 5], "look_at": [0, 0, 0], "lens": {{ "aperture": 2, "focus": 5, {shape} }}"#
    ));
    let ray = |pair| view.ray_through_lens(100.0_f32, 50.0, || pair);
    pairs.map(|pair| ray(pair).origin).map(|p| (p.x, p.y)).collect()
}

#[test]
fn an_aperture_is_covered_evenly() {
    const COUNT: u32 = 1 << 18;
    let along = |index: u32, step: f64| (f64::from(index) * step).fract() as f32;
    let even = |count: u32| (0..count).map(move |index| (along(index, 0.754_877_666), along(index, 0.569_840_291)));
    for blades in [0, 5, 6, 8, 11, 16] {
        let mut cells = [[0_u32; 16]; 16];
        for (x, y) in points_of(&format!("\"blades\": {blades}"), even(COUNT)) {
            assert!(x.hypot(y) < 1.000_01, "{blades} blades: ({x}, {y}) is not in the circle");
            cells[((y + 1.000_1) * 7.999) as usize][((x + 1.000_1) * 7.999) as usize] += 1;
        }
        let n = blades as f32;
        let (sine, cosine) = sin_cos_degrees(360.0 / n.max(1.0));
        let area = if blades == 0 { std::f32::consts::PI } else { 0.5 * n * sine };
        let wanted = COUNT as f32 / area / 64.0;
        // The cells of the square in the circle in the pentagon.
        for got in cells[6..10].iter().flat_map(|row| &row[6..10]) {
            assert!((*got as f32 / wanted - 1.0).abs() < 0.04, "{blades} blades: {got} instead of {wanted}: {cells:?}");
        }
        // Nothing is left out: the mean of x² + y² is that of the shape.
        let points = points_of(&format!("\"blades\": {blades}"), even(4096));
        let mean = points.iter().map(|(x, y)| x * x + y * y).sum::<f32>() / points.len() as f32;
        let of_shape = if blades == 0 { 0.5 } else { (2.0 + cosine) / 6.0 };
        assert!((mean / of_shape - 1.0).abs() < 0.01, "{blades} blades: {mean} instead of {of_shape}");
    }
}

#[test]
fn a_corner_of_a_polygon_is_at_its_top_and_turns_counter_clockwise() {
    for blades in [5_u32, 6, 9] {
        for (turn, corner) in [(0.0, (0.0, 1.0)), (90.0, (-1.0, 0.0)), (-90.0_f32, (1.0, 0.0))] {
            let points = points_of(&format!("\"blades\": {blades}, \"turn\": {turn}"), pairs(64));
            let along = |(x, y): &(f32, f32)| x * corner.0 + y * corner.1;
            let farthest = points.iter().max_by(|a, b| along(a).total_cmp(&along(b))).expect("points");
            assert!((farthest.0 - corner.0).hypot(farthest.1 - corner.1) < 0.07, "{blades}, {turn}: {farthest:?}");
            // Every point is on the inner side of each side.
            let (_, apothem) = sin_cos_degrees(180.0 / blades as f32);
            for side in 0..blades {
                let degrees = 90.0 + turn + (side as f32 + 0.5) * 360.0 / blades as f32;
                let (sine, cosine) = sin_cos_degrees(degrees);
                let most = points.iter().map(|(x, y)| x * cosine + y * sine).fold(0.0, f32::max);
                assert!(most < apothem + 1e-5 && most > 0.95 * apothem, "{blades}, {turn}: {most} for {apothem}");
            }
        }
    }
}

#[test]
fn boxes_beside_the_blurred_picture_are_outside_the_view_and_no_others() {
    let around = |[x, y, z]: [f32; 3]| {
        let half = vec3(0.02, 0.02, 0.02);
        crate::bounds::Bounds { min: vec3(x, y, z) - half, max: vec3(x, y, z) + half }
    };
    for projection in ["\"fov\": 40", "\"projection\": { \"orthographic\": { \"height\": 2 } }"] {
        let of = |lens: &str| view(&format!(r#""position": [0, 0, 5], "look_at": [0, 0, 0], {projection} {lens}"#));
        let (pinhole, lens) = (of(""), of(r#", "lens": { "aperture": 2, "focus": 2 }"#));
        let (mut blurred, mut beside) = (0, 0);
        for index in 0..3000_u32 {
            let along = |step: f64| (f64::from(index) * step).fract() as f32;
            let p = [along(0.819_17) * 16.0 - 8.0, along(0.671_04) * 16.0 - 8.0, along(0.549_7) * 12.0 - 7.0];
            let depth = 5.0 - p[2];
            // A point is seen through the lens if it is less than the disc's radius beside the picture at its depth.
            let (half_width, half_height) =
                if projection.contains("fov") { (2.0 * 0.363_97 * depth, 0.363_97 * depth) } else { (2.0, 1.0) };
            let radius = (depth - 2.0).abs() / 2.0;
            let outside = |radius: f32| p[0].abs() > half_width + radius || p[1].abs() > half_height + radius;
            if !outside(radius - 0.1) {
                assert!(!lens.is_outside_view(around(p)), "{projection}: {p:?} is seen");
            }
            if outside(radius + 0.2) {
                assert!(lens.is_outside_view(around(p)), "{projection}: {p:?} is not seen");
                beside += 1;
            }
            blurred += u32::from(pinhole.is_outside_view(around(p)) && !lens.is_outside_view(around(p)));
        }
        assert!(blurred > 100 && beside > 100, "{projection}: {blurred} and {beside}");
    }
}
