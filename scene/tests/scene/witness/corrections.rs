//! Corners, edges, fog and distant patterns, compared with values calculated by hand.

use scene::real::Vec3;
use scene::{Integrator, Job};

/// Two walls and a floor that intersect at the origin, seen along (−1, −1, −1); `planes` of them.
fn corner(planes: &str, camera: &str, rest: &str) -> Job {
    job(&format!(
        r#"{{ "scene": {{ "camera": {{ {camera} }}, "background": {{ "color": [1, 1, 1] }}, "lights": [],
            "ambient_occlusion": {{ "distance": 0.5 }},
            "materials": {{ "white": {{ "diffuse": {{ "kd": [1, 1, 1], "ambient": [1, 1, 1] }} }} }},
            "objects": [{planes}] }},
        "image": {{ "width": 64, "height": 64, "samples": 1 {rest} }} }}"#
    ))
}

fn job(text: &str) -> Job {
    scene::parse(text.as_bytes()).unwrap_or_else(|fault| panic!("{fault:?}"))
}

fn plane(normal: &str) -> String {
    format!(r#"{{ "material": "white", "shape": {{ "plane": {{ "normal": {normal}, "offset": 0 }} }} }}"#)
}

/// The red channel of some pixels.
fn reds(job: &Job, pixels: &[(f32, f32)]) -> Vec<f32> {
    let at_frame = job.at(0).expect("a first frame");
    let program = Integrator::new(&at_frame);
    pixels.iter().map(|&(x, y)| program.pixel(x, y).color.x).collect()
}

#[test]
fn planes_and_corners_have_exact_ambient_visibility() {
    let [floor, wall, other] = ["[0, 1, 0]", "[1, 0, 0]", "[0, 0, 1]"].map(plane);
    let across =
        r#""position": [1, 2, 0], "look_at": [0, 1e-4, 0], "projection": { "orthographic": { "height": 0.001 } }"#;
    let into = r#""position": [2, 2, 2], "look_at": [0, 0, 0], "projection": { "orthographic": { "height": 0.001 } }"#;
    let middle = [(20.0, 20.0), (40.0, 20.0), (31.0, 45.0)];
    for (planes, camera, least, most) in [
        (floor.clone(), across, 0.999, 1.0),
        (format!("{floor}, {wall}"), across, 0.48, 0.52),
        (format!("{floor}, {wall}, {other}"), into, 0.22, 0.33),
    ] {
        let open = reds(&corner(&planes, camera, ""), &middle);
        assert!(open.iter().all(|open| (least..=most).contains(open)), "{open:?} for {planes}");
    }
}

#[test]
fn a_crease_shows_no_bright_line() {
    let planes = ["[0, 1, 0]", "[1, 0, 0]"].map(plane).join(", ");
    let camera = r#""position": [2, 2, 0.1], "look_at": [0, 0, 0.1], "fov": 3"#;
    let job = corner(&planes, camera, "");
    let rows: Vec<(f32, f32)> = (0..64).map(|y| (32.0, y as f32)).collect();
    let open = reds(&job, &rows);
    let darkest = open.iter().copied().fold(1.0, f32::min);
    let crease = &open[30..34];
    assert!(crease.iter().all(|&open| open < darkest + 0.03), "{open:?}");
    assert!((0.45..0.55).contains(&darkest), "{darkest}");
}

#[test]
fn a_normal_near_an_edge_is_that_of_its_face() {
    let job = job(r#"{ "scene": { "camera": { "position": [3, 3, 3], "look_at": [0, 0, 0] },
            "objects": [{ "shape": { "box": { "size": [1, 1, 1] } } }] },
        "image": { "width": 256, "height": 256, "samples": 1 } }"#);
    let at_frame = job.at(0).expect("a first frame");
    let program = Integrator::new(&at_frame);
    let (mut hits, mut blended) = (0, 0);
    for y in 0..256_u16 {
        for x in 0..256_u16 {
            let met = program.layer_values(f32::from(x), f32::from(y));
            let Vec3 { x: a, y: b, z: c } = met.normal;
            let greatest = a.max(b).max(c);
            hits += u32::from(greatest > 0.0);
            blended += u32::from(greatest > 0.0 && greatest < 0.999);
        }
    }
    assert!(hits > 5_000, "{hits}");
    // About a thousand pixels show edges; if normals were measured over half a pixel, as many would be blended.
    assert!(blended * 400 < hits, "{blended} of {hits}");
}

#[test]
fn rays_above_the_horizon_miss_and_normals_face_the_viewer() {
    let job = job(r#"{ "scene": { "camera": { "position": [0, 1, 0], "look_at": [0, 0.9, -5] },
            "objects": [{ "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } }],
            "march": { "max_distance": 100000, "max_steps": 4096 } },
        "image": { "width": 64, "height": 400, "samples": 1 } }"#);
    let at_frame = job.at(0).expect("a first frame");
    let program = Integrator::new(&at_frame);
    let view = at_frame.scene().camera.view(64, 400);
    for y in 0..400_u16 {
        let met = program.layer_values(31.0, f32::from(y));
        let down = f64::from(view.ray(31.5_f32, f32::from(y) + 0.5).direction.y);
        let want = if down < 0.0 { -1.0 / down } else { f64::INFINITY };
        if want > 5e4 {
            assert!(down < 0.0 || met.depth == f32::INFINITY, "row {y} sees the floor above the horizon");
            continue;
        }
        let got = f64::from(met.depth);
        assert!((got - want).abs() < 1e-4 * want, "row {y}: {got} for {want}");
        assert!(met.normal.y > 0.999, "row {y}: {:?}", met.normal);
    }
}

#[test]
fn fog_without_color_uses_the_horizon_below_it() {
    let job = job(r#"{ "scene": { "camera": { "position": [0, 2, 0], "look_at": [0, 1, -5] },
            "background": { "day": { "sun": [0.3, 0.6, -0.4], "ground": [0.4, 0.2, 0.05] } },
            "fog": { "density": 2 },
            "objects": [{ "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } }] },
        "image": { "width": 9, "height": 65, "samples": 1 } }"#);
    let at_frame = job.at(0).expect("a first frame");
    let program = Integrator::new(&at_frame);
    let view = at_frame.scene().camera.view(9, 65);
    for y in [40.0, 50.0, 60.0_f32] {
        let Vec3 { x, z, .. } = view.ray(4.5, y + 0.5).direction;
        let level = 1.0 / (x * x + z * z).sqrt();
        let horizon = scene::real::vec3(x * level, 0.0, z * level);
        let want = at_frame.scene().background.radiance(horizon);
        let got = program.pixel(4.0, y).color;
        assert!((got - want).length() < 0.02 * want.length(), "row {y}: {got:?} for {want:?}");
    }
}

/// A textured floor under uniform light, seen at a slant; `samples` samples per pixel.
fn floor_with(texture: &str, height: u32, samples: u32) -> Job {
    let width = height * 2;
    job(&format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0.3, 1, 0.2], "look_at": [0.1, 0.6, -5] }}, "lights": [],
            "background": {{ "color": [0.5, 0.5, 0.5] }},
            "materials": {{ "floor": {{ "flat": {{ "color": [1, 1, 1] }} }},
                "textured": {{ "diffuse": {{ "kd": {texture}, "ambient": [1, 1, 1] }} }} }},
            "objects": [{{ "material": "textured", "shape": {{ "plane": {{ "normal": [0, 1, 0], "offset": 0 }} }} }}] }},
        "image": {{ "width": {width}, "height": {height}, "samples": {samples} }} }}"#
    ))
}

/// Mean square of the difference between one sample per pixel and many, in some rows.
fn roughness(texture: &str, rows: std::ops::Range<u16>) -> f64 {
    let (one, many) = (floor_with(texture, 96, 1), floor_with(texture, 96, 256));
    let pixels: Vec<(f32, f32)> =
        rows.flat_map(|y| (0..192_u16).step_by(5).map(move |x| (f32::from(x), f32::from(y)))).collect();
    let (got, want) = (reds(&one, &pixels), reds(&many, &pixels));
    let squares = got.iter().zip(&want).map(|(got, want)| f64::from(got - want).powi(2));
    squares.sum::<f64>() / pixels.len() as f64
}

#[test]
fn distant_patterns_show_their_mean() {
    for (texture, most) in [
        (r#"{ "checker": { "cell": 0.5, "axes": "xz" } }"#, 0.02),
        (r#"{ "stripes": { "direction": [1, 0, 1], "width": 0.4 } }"#, 0.01),
        (r#"{ "bricks": { "size": [0.5, 0.3], "mortar": 0.06, "mortar_color": [1, 1, 1] } }"#, 0.01),
    ] {
        // Black and white differ by 1: a pixel that samples only one of them is wrong by a half.
        let error = roughness(texture, 42..60);
        println!("{error} for {texture}");
        assert!(error < most, "{error} for {texture}");
    }
}
