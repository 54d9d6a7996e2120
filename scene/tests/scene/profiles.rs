//! Profiles: contract tests in the plane, and errors of polygons.

use scene::kinds::Example;
use scene::nodes::Exactness;
use scene::profiles::Profile;

fn profile(json: &str) -> Profile {
    serde_json::from_str(json).expect("it is a profile")
}

/// Points all over a square of edge 4, without a pattern.
fn places(count: u32) -> impl Iterator<Item = (f32, f32)> {
    let scattered = |n: u32, share: f64| ((f64::from(n) * share).fract() * 4.0 - 2.0) as f32;
    (1..=count).map(move |n| (scattered(n, 0.754_877_666_246_692_7), scattered(n, 0.569_840_290_998_053_2)))
}

#[test]
fn the_schema_describes_every_profile_and_each_of_its_keys() {
    let schema = scene::schema();
    for Example { kind, json, .. } in Profile::examples() {
        let definition = &schema["$defs"][kind];
        assert!(definition["description"].is_string(), "{kind} has no description");
        assert_eq!(definition["additionalProperties"], false, "{kind} takes unknown keys");
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        let (_, value) = json.as_object().unwrap().iter().next().unwrap();
        for key in value.as_object().unwrap().keys() {
            assert!(definition["properties"][key]["description"].is_string(), "{kind}.{key} has no description");
        }
    }
}

#[test]
fn a_circle_of_the_exact_distance_touches_the_outline() {
    const TURNS: u16 = 1_000;
    for Example { kind, json, .. } in Profile::examples() {
        let profile = profile(&json);
        if profile.exactness() != Exactness::Exact {
            continue;
        }
        for (x, y) in places(150) {
            let distance: f32 = profile.distance(x, y);
            let around = (0..TURNS).map(|turn| {
                let (s, c) = (f32::from(turn) / f32::from(TURNS) * std::f32::consts::TAU).sin_cos();
                profile.distance(x + c * distance.abs(), y + s * distance.abs())
            });
            let least = around.map(|there| there * distance.signum()).fold(f32::INFINITY, f32::min);
            // Maximum amount by which a corner of the outline is missed between two of the tested directions.
            let spacing = distance.abs() * std::f32::consts::PI / f32::from(TURNS);
            assert!(least.abs() <= spacing + 1e-5, "{kind}: {distance} at {x}, {y}, {least} is left");
        }
    }
}

#[test]
fn a_mirrored_profile_is_its_own_mirror_image() {
    for Example { kind, json, .. } in Profile::examples() {
        let profile = profile(&json);
        let is_same = places(500).all(|(x, y)| profile.distance(x, y) == profile.distance(-x, y));
        assert!(is_same || !profile.is_symmetric(), "{kind} {json}");
    }
}

/// The polygon whose corners have these distances from the origin, evenly spaced from the top.
fn polygon_around(distances: impl Iterator<Item = f32> + Clone) -> Profile {
    let count = distances.clone().count() as f32;
    let corners: Vec<[f32; 2]> = distances
        .enumerate()
        .map(|(corner, distance)| {
            let (s, c) = (corner as f32 / count * std::f32::consts::TAU).sin_cos();
            [s * distance, c * distance]
        })
        .collect();
    profile(&serde_json::json!({ "polygon": { "points": corners } }).to_string())
}

fn assert_same(a: &Profile, b: &Profile) {
    for (x, y) in places(3_000) {
        let (here, there): (f32, f32) = (a.distance(x, y), b.distance(x, y));
        assert!((here - there).abs() <= 2e-6, "{here} and {there} at {x}, {y} of {a:?}");
    }
}

#[test]
fn regular_polygons_and_stars_are_the_polygons_of_their_corners() {
    for count in [3, 4, 5, 6, 7, 8, 11, 16, 33, 64] {
        let regular = profile(&format!(r#"{{ "regular_polygon": {{ "sides": {count}, "radius": 0.9 }} }}"#));
        assert_same(&regular, &polygon_around(std::iter::repeat_n(0.9, count)));
        let star = profile(&format!(r#"{{ "star": {{ "points": {count}, "outer": 1.1, "inner": 0.6 }} }}"#));
        assert_same(&star, &polygon_around(std::iter::repeat_n([1.1, 0.6], count).flatten()));
    }
}

#[test]
fn an_ellipse_matches_points_of_its_curve() {
    for (width, height) in [(2.0, 1.0), (0.02, 1.8), (1.0, 1.0), (1.0, 0.99)] {
        let ellipse = profile(&format!(r#"{{ "ellipse": {{ "size": [{width}, {height}] }} }}"#));
        // A quarter of the ellipse, by tangents of half the angle.
        let curve: Vec<(f64, f64)> = (0..=10_000)
            .map(|step| f64::from(step) / 10_000.0)
            .map(|t| ((1.0 - t * t) / (1.0 + t * t) * width / 2.0, t / (1.0 + t * t) * height))
            .collect();
        // Also on the axes and at the centers of curvature, where the nearest point is not unique.
        let cusp = ((width * width - height * height) / (2.0 * width)) as f32;
        let special = [(0.0, 0.0), (cusp, 0.0), (cusp * 0.99, 1e-7), (0.3, 0.0), (0.0, 0.3), (1e-8, -1e-8)];
        for (x, y) in places(200).chain(special) {
            let (px, py) = (f64::from(x).abs(), f64::from(y).abs());
            let nearest = curve.iter().map(|(cx, cy)| (px - cx).hypot(py - cy)).fold(f64::INFINITY, f64::min);
            let (share_x, share_y) = (2.0 * px / width, 2.0 * py / height);
            let is_inside = share_x * share_x + share_y * share_y < 1.0;
            let (want, got) = (if is_inside { -nearest } else { nearest }, f64::from(ellipse.distance(x, y)));
            // The curve's points are at most 2e-4 apart, so it is never farther than 1e-4 from one.
            let missed = (nearest * nearest + 1e-4 * 1e-4).sqrt() - nearest;
            assert!((got - want).abs() <= missed + 3e-6, "{got}, not {want}, at {x}, {y} of {width} by {height}");
        }
    }
}

#[test]
fn a_polygon_is_the_same_either_way_round() {
    let points = [[0.0, 1.0], [1.0, -0.2], [0.1, 0.2], [-0.8, -0.9], [-0.5, 0.3]];
    let mut reversed = points;
    reversed.reverse();
    let polygon = |points: [[f64; 2]; 5]| profile(&serde_json::json!({ "polygon": { "points": points } }).to_string());
    assert_same(&polygon(points), &polygon(reversed));
}

/// Pointer and message of the error of a scene with this shape only.
fn fault(shape: &str) -> (String, String) {
    let text = format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 4], "look_at": [0, 0, 0], "fov": 40 }},
            "objects": [{{ "shape": {shape} }}] }}, "image": {{ "width": 32, "height": 32 }} }}"#
    );
    match scene::parse(text.as_bytes()).expect_err("it is invalid") {
        scene::ParseError::Invalid(mut faults) => {
            let fault = faults.remove(0);
            let within = fault.pointer.strip_prefix("/scene/objects/0/shape/").expect("it is in the shape");
            (within.to_owned(), fault.message)
        }
        other @ scene::ParseError::NotJson(_) => panic!("{other}"),
    }
}

fn polygon_fault(points: &str) -> (String, String) {
    let (place, message) =
        fault(&format!(r#"{{ "extrude": {{ "profile": {{ "polygon": {{ "points": {points} }} }}, "height": 1 }} }}"#));
    (place.strip_prefix("extrude/profile/polygon/").expect("it is in the polygon").to_owned(), message)
}

#[test]
fn an_invalid_polygon_is_reported_with_pointer_and_fix() {
    let cases = [
        ("[[0, 0], [1, 0]]", "points", "has 2 points: a polygon needs 3 to 256"),
        ("[[0, 0], [1, 0], [1, 1], [1, 1]]", "points/3", "is the same point as points/2"),
        ("[[0, 0], [1, 0], [1, 1], [0, 0]]", "points/3", "is the same point as points/0"),
        ("[[0, 0], [1, 1], [1, 0], [0, 1]]", "points/2", "crosses the one from points/0 to points/1"),
        ("[[0, 0], [2, 0], [2, 2], [1, 0], [0, 2]]", "points/2", "crosses the one from points/0 to points/1"),
        ("[[0, 0], [2, 0], [1, 0], [1, 1]]", "points/1", "goes back along the edge before it"),
    ];
    for (points, place, words) in cases {
        let (at, message) = polygon_fault(points);
        assert_eq!(at, place, "{points}: {message}");
        assert!(message.contains(words), "{points}: {message}");
    }
}

#[test]
fn invalid_sweeps_are_reported_with_pointer_and_fix() {
    let cases = [
        (
            r#"{ "extrude": { "profile": { "circle": { "radius": 1 } }, "height": 0.5, "round": 0.3 } }"#,
            ("extrude/round", "must be at most half of the height: make round 0.25 or less"),
        ),
        (
            r#"{ "revolve": { "profile": { "circle": { "radius": 1 } }, "offset": -1.5 } }"#,
            ("revolve/offset", "puts the whole profile beyond the axis: make offset more than -1"),
        ),
        (
            r#"{ "revolve": { "profile": { "rectangle": { "size": [1, 2], "round": 0.6 } } } }"#,
            ("revolve/profile/rectangle/round", "must be at most half of the shorter side: make round 0.5 or less"),
        ),
    ];
    for (shape, (place, message)) in cases {
        assert_eq!(fault(shape), (place.to_owned(), message.to_owned()));
    }
}

fn text(string: &str) -> Profile {
    profile(&format!(r#"{{ "text": {{ "string": "{string}", "size": 1 }} }}"#))
}

#[test]
fn a_capital_i_is_the_rectangle_of_the_font() {
    // 385 by 1493 of the font's 2048 units, half a unit left of the center.
    let size = [385.0 / 2048.0, 1493.0 / 2048.0];
    let rectangle = profile(&serde_json::json!({ "rectangle": { "size": size } }).to_string());
    let letter = text("I");
    for (x, y) in places(1_000) {
        let (got, want): (f32, f32) = (letter.distance(x, y), rectangle.distance(x + 0.5 / 2048.0, y));
        assert!((got - want).abs() < 1e-5, "{got}, not {want} at {x}, {y}");
    }
}

#[test]
fn holes_of_letters_are_outside() {
    for string in ["O", "0", "D", "Q", "©", "4"] {
        let letter = text(string);
        let crossed = (-100_i16..100).map(|n| letter.distance(f32::from(n) * 0.01, 0.031) < 0.0);
        let changes = crossed.clone().zip(crossed.skip(1)).filter(|(here, there)| here != there).count();
        assert!(changes >= 4 && changes % 2 == 0, "{string} has {changes} sides");
    }
}

#[test]
fn kerned_letters_are_nearer() {
    let width = |string: &str| {
        let extent = text(string).extent(0.0);
        extent.high[0] - extent.low[0]
    };
    assert!(width("AV") < width("A") + width("V"));
    assert!(width("HH") > width("H") + width("H"));
}

#[test]
fn text_without_an_outline_is_reported_with_the_reason() {
    let cases = [
        ("東", "has '東', which the font lacks: it has Latin letters, digits, punctuation and arrows"),
        ("two\\nlines", "has '\\n', which the font lacks: it has Latin letters, digits, punctuation and arrows"),
        (" ", "shows nothing: write a letter or more"),
        (&"l".repeat(65), "has 65 characters: use at most 64"),
        (&"®".repeat(60), "has outlines of 4947 lines and curves: use fewer letters, for at most 2000"),
    ];
    for (string, message) in cases {
        let shape = format!(
            r#"{{ "extrude": {{ "profile": {{ "text": {{ "string": "{string}", "size": 1 }} }}, "height": 1 }} }}"#
        );
        assert_eq!(fault(&shape), ("extrude/profile/text/string".to_owned(), message.to_owned()));
    }
}

#[test]
fn a_long_text_counts_as_several_nodes() {
    let node = |string: &str| -> scene::nodes::Node {
        let shape = format!(
            r#"{{ "extrude": {{ "profile": {{ "text": {{ "string": "{string}", "size": 1 }} }}, "height": 1 }} }}"#
        );
        serde_json::from_str(&shape).expect("it is a node")
    };
    assert_eq!(node("I").node_count(), 4);
    assert!(node("Sphere tracing").node_count() > 100);
}
