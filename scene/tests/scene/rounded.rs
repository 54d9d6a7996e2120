//! Round primitives compared with their definitions as sets of points, without distances.

#![expect(clippy::disallowed_methods, reason = "the C library's functions are the independent witness here")]

use scene::nodes::Node;
use scene::real::vec3;

type P = [f64; 3];

/// Whether a point is in a solid.
type Holds = fn(P) -> bool;

/// Pseudorandom numbers from a fixed seed, so that failures repeat.
struct Random(u64);

impl Random {
    fn next(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn point(&mut self, reach: f64) -> P {
        [0; 3].map(|_| self.next(-reach, reach))
    }
}

fn node(text: &str) -> Node {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{text}: {error}"))
}

fn distance(node: &Node, [x, y, z]: P) -> f64 {
    f64::from(node.distance(vec3(x as f32, y as f32, z as f32)))
}

fn across([x, _, z]: P) -> f64 {
    x.hypot(z)
}

fn length([x, y, z]: P) -> f64 {
    x.hypot(y).hypot(z)
}

fn minus(a: P, b: P) -> P {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Minimum of a function over many values from 0 to 1.
fn least(f: impl Fn(f64) -> f64) -> f64 {
    (0..=2_000).map(|step| f(f64::from(step) / 2_000.0)).fold(f64::INFINITY, f64::min)
}

/// A shape's JSON with an independent definition of the same solid.
fn solids() -> Vec<(&'static str, Holds)> {
    vec![
        (r#"{ "cone": { "radius": 0.8, "height": 1.8 } }"#, |p| {
            p[1].abs() <= 0.9 && across(p) <= 0.8 * (0.9 - p[1]) / 1.8
        }),
        (r#"{ "capped_cone": { "bottom_radius": 0.3, "top_radius": 0.9, "height": 1 } }"#, |p| {
            p[1].abs() <= 0.5 && across(p) <= 0.6 + 0.6 * p[1]
        }),
        (r#"{ "infinite_cone": { "degrees": 35 } }"#, |p| across(p) <= -p[1] * 35_f64.to_radians().tan()),
        (r#"{ "round_cone": { "bottom_radius": 0.6, "top_radius": 0.2, "height": 1.8 } }"#, |p| {
            least(|t| length(minus(p, [0.0, -0.3 + t, 0.0])) - (0.6 - 0.4 * t)) <= 0.0
        }),
        // The upper ball fills the full height.
        (r#"{ "round_cone": { "bottom_radius": 0.3, "top_radius": 0.6, "height": 1.2 } }"#, |p| length(p) <= 0.6),
        (r#"{ "solid_angle": { "degrees": 120, "radius": 1 } }"#, |p| {
            length(p) <= 1.0 && p[1] >= length(p) * 120_f64.to_radians().cos()
        }),
        (r#"{ "rounded_cylinder": { "radius": 0.8, "height": 1, "round": 0.5 } }"#, |p| {
            (across(p) - 0.3).max(0.0).hypot(p[1]) <= 0.5
        }),
        (r#"{ "cut_sphere": { "radius": 1, "cut": -0.4 } }"#, |p| length(p) <= 1.0 && p[1] >= -0.4),
        (r#"{ "cut_sphere": { "radius": 1, "cut": 0.4 } }"#, |p| length(p) <= 1.0 && p[1] >= 0.4),
        (r#"{ "cut_hollow_sphere": { "radius": 1, "cut": 0.5, "thickness": 0.3 } }"#, |p| {
            // Down the bowl from its brim, which is 60 degrees from the axis.
            let angle = |t: f64| (60.0 + 120.0 * t).to_radians();
            least(|t| (across(p) - angle(t).sin()).hypot(p[1] - angle(t).cos())) <= 0.15
        }),
        (r#"{ "death_star": { "radius": 1, "bite": 0.8, "distance": 1.1 } }"#, |p| {
            length(p) <= 1.0 && length(minus(p, [0.0, 1.1, 0.0])) >= 0.8
        }),
        (r#"{ "ellipsoid": { "radii": [1.2, 0.4, 0.7] } }"#, |p| length([p[0] / 1.2, p[1] / 0.4, p[2] / 0.7]) <= 1.0),
        (r#"{ "vesica": { "a": [0, -1, 0], "b": [0, 1, 0], "radius": 0.5 } }"#, |p| {
            // Through the tips, and half as wide as high: the circle's center is 0.75 behind the axis.
            (across(p) + 0.75).hypot(p[1]) <= 1.25
        }),
        // As thick as it is long: a ball.
        (r#"{ "vesica": { "a": [0, -0.8, 0], "b": [0, 0.8, 0], "radius": 0.8 } }"#, |p| length(p) <= 0.8),
        // Collinear corners: a capsule.
        (r#"{ "triangle": { "a": [-0.8, 0, 0], "b": [0.8, 0, 0], "c": [0.4, 0, 0], "radius": 0.3 } }"#, |p| {
            (p[0].abs() - 0.8).max(0.0).hypot(p[1]).hypot(p[2]) <= 0.3
        }),
        (r#"{ "triangle": { "a": [-1, -1, 0], "b": [1, -1, 0], "c": [-1, 1, 0], "radius": 0.2 } }"#, |p| {
            let [a, b, c] = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, 1.0, 0.0]];
            let above = p[0] >= -1.0 && p[1] >= -1.0 && p[0] + p[1] <= 0.0;
            let to_side = |from: P, to: P| least(|t| length(minus(p, between(from, to, t))));
            (above && p[2].abs() <= 0.2) || to_side(a, b).min(to_side(b, c)).min(to_side(c, a)) <= 0.2
        }),
        (r#"{ "capped_torus": { "radius": 0.9, "tube": 0.2, "degrees": 140 } }"#, |p| {
            let angle = |t: f64| (140.0 * t - 70.0).to_radians();
            least(|t| length(minus(p, [0.9 * angle(t).sin(), 0.0, 0.9 * angle(t).cos()]))) <= 0.2
        }),
        (r#"{ "capped_torus": { "radius": 0.9, "tube": 0.2, "degrees": 290 } }"#, |p| {
            let angle = |t: f64| (290.0 * t - 145.0).to_radians();
            least(|t| length(minus(p, [0.9 * angle(t).sin(), 0.0, 0.9 * angle(t).cos()]))) <= 0.2
        }),
        (r#"{ "link": { "height": 2.2, "radius": 0.4, "tube": 0.2 } }"#, |p| {
            // The center of the tube: all points 0.4 away from a segment of half length 0.5.
            let out = p[0].hypot((p[1].abs() - 0.5).max(0.0)) - 0.4;
            out.hypot(p[2]) <= 0.2
        }),
        (r#"{ "horseshoe": { "radius": 0.8, "degrees": 240, "leg": 0.4, "width": 0.3, "thickness": 0.5 } }"#, |p| {
            in_band(p, 120.0, [0.8, 0.4, 0.3, 0.5])
        }),
        (r#"{ "horseshoe": { "radius": 0.8, "degrees": 90, "leg": 0.6, "width": 0.3, "thickness": 0.5 } }"#, |p| {
            in_band(p, 45.0, [0.8, 0.6, 0.3, 0.5])
        }),
        (r#"{ "u": { "radius": 0.6, "leg": 0.7, "width": 0.3, "thickness": 0.4 } }"#, |p| {
            in_band(p, 90.0, [0.6, 0.7, 0.3, 0.4])
        }),
        (
            r#"{ "bezier_tube": { "a": [-1, -0.5, 0], "b": [0.3, 1.5, 0.8], "c": [0.8, -0.7, 0.1], "radius": 0.2 } }"#,
            |p| least(|t| length(minus(p, curve([[-1.0, -0.5, 0.0], [0.3, 1.5, 0.8], [0.8, -0.7, 0.1]], t)))) <= 0.2,
        ),
    ]
}

/// Whether a point is in a ribbon of half an arc in degrees, and of radius, leg, width and thickness.
fn in_band(p: P, half_arc: f64, [radius, leg, width, thickness]: [f64; 4]) -> bool {
    let flat = |x: f64, y: f64| (p[0].abs() - x).hypot(p[1] - y);
    let (sine, cosine) = half_arc.to_radians().sin_cos();
    let arc = least(|t| {
        let (sine, cosine) = (half_arc * t).to_radians().sin_cos();
        flat(radius * sine, -radius * cosine)
    });
    let straight = least(|t| flat(radius * sine + leg * t * cosine, leg * t * sine - radius * cosine));
    arc.min(straight) <= width / 2.0 && p[2].abs() <= thickness / 2.0
}

/// The point at t of a quadratic Bézier curve, by de Casteljau's construction.
fn curve([a, b, c]: [P; 3], t: f64) -> P {
    between(between(a, b, t), between(b, c, t), t)
}

fn between(from: P, to: P, t: f64) -> P {
    [0, 1, 2].map(|axis: usize| from[axis] + (to[axis] - from[axis]) * t)
}

#[test]
fn a_distance_is_negative_only_inside_the_solid() {
    for (text, holds) in solids() {
        let (node, mut random, mut inside) = (node(text), Random(7), 0);
        for _ in 0..4_000 {
            let p = random.point(1.3);
            let distance = distance(&node, p);
            // The samples are a thousandth apart.
            if distance.abs() > 1e-3 {
                assert_eq!(distance < 0.0, holds(p), "{text}: {distance} at {p:?}");
                inside += u32::from(distance < 0.0);
            }
        }
        assert!(inside > 50, "{text}: only {inside} points were inside");
    }
}

#[test]
fn a_bezier_tube_matches_sampled_points_of_its_curve() {
    let mut random = Random(8);
    for round in 0..60 {
        let [a, mut b, c] = [(); 3].map(|()| random.point(1.0));
        if round % 3 == 0 {
            // Nearly straight, and sometimes reversing on itself.
            let (share, off) = (random.next(-0.5, 1.5), random.point(1e-4));
            b = [0, 1, 2].map(|axis: usize| a[axis] + (c[axis] - a[axis]) * share + off[axis]);
        }
        let node = node(&format!(r#"{{ "bezier_tube": {{ "a": {a:?}, "b": {b:?}, "c": {c:?}, "radius": 0.1 }} }}"#));
        for _ in 0..100 {
            let p = random.point(2.0);
            let want = least(|t| length(minus(p, curve([a, b, c], t)))) - 0.1;
            let got = distance(&node, p);
            // A sample is never nearer than the curve; if p is near the curve, the spacing of the samples matters.
            assert!(got < want + 1e-5 && got > want - 2e-3, "{a:?} {b:?} {c:?}: {got}, not {want}, at {p:?}");
        }
    }
}

/// The nearest point of an ellipsoid, by bisection in 64 bits: Eberly's method.
fn to_ellipsoid(radii: P, p: P) -> f64 {
    let p = p.map(|c| c.abs().max(1e-9));
    let least = radii.iter().fold(f64::INFINITY, |least, &r| least.min(r));
    let (mut low, mut high) = (-least * least, 10.0 * length(p) * 10.0 + 10.0);
    let ratio = |t: f64| [0, 1, 2].map(|axis: usize| radii[axis] * p[axis] / (t + radii[axis] * radii[axis]));
    for _ in 0..200 {
        let middle = f64::midpoint(low, high);
        if length(ratio(middle)) > 1.0 { low = middle } else { high = middle }
    }
    let nearest = ratio(high);
    let nearest = [0, 1, 2].map(|axis: usize| nearest[axis] * radii[axis]);
    length(minus(p, nearest)) * high.signum()
}

#[test]
fn an_ellipsoid_distance_is_a_tight_lower_bound() {
    let mut random = Random(9);
    for _ in 0..200 {
        let radii = [(); 3].map(|()| 10_f64.powf(random.next(-1.5, 0.3)) as f32).map(f64::from);
        let node = node(&format!(r#"{{ "ellipsoid": {{ "radii": {radii:?} }} }}"#));
        for round in 0..200 {
            let reach = random.point(2.0);
            let p = if round % 2 == 0 { reach } else { [0, 1, 2].map(|axis: usize| reach[axis] * radii[axis] * 0.6) };
            let (got, want) = (distance(&node, p), to_ellipsoid(radii, p));
            assert!(got < want + 4e-6 && got > want - 1e-3, "{radii:?}: {got}, not {want}, at {p:?}");
        }
    }
}

#[test]
fn a_quad_is_the_two_triangles_of_its_corners() {
    let whole = node(
        r#"{ "quad": { "a": [-1, -0.5, 0], "b": [0.7, -0.8, 0.2], "c": [0.9, 0.6, 0.9], "d": [-0.8, 0.9, 0.7], "radius": 0.1 } }"#,
    );
    // The corners are in one plane except for their last digits.
    let half = |b: &str| {
        node(&format!(r#"{{ "triangle": {{ "a": [-1, -0.5, 0], "b": {b}, "c": [0.9, 0.6, 0.9], "radius": 0.1 }} }}"#))
    };
    let (below, above) = (half("[0.7, -0.8, 0.2]"), half("[-0.8, 0.9, 0.7]"));
    let mut random = Random(10);
    for _ in 0..5_000 {
        let p = random.point(2.0);
        let (got, want) = (distance(&whole, p), distance(&below, p).min(distance(&above, p)));
        assert!((got - want).abs() < 1e-5, "{got}, not {want}, at {p:?}");
    }
}

#[test]
fn the_smallest_and_the_largest_shapes_have_finite_distances() {
    let mut random = Random(11);
    for Fitted { text } in [1e-6, 1e-3, 1e3, 4e5].into_iter().flat_map(Fitted::all) {
        let node = node(&text);
        for reach in [1e-6, 1.0, 1e3, 1e6] {
            for _ in 0..200 {
                let p = random.point(reach);
                assert!(distance(&node, p).is_finite(), "{text} at {p:?}");
            }
        }
    }
}

/// A shape in a given size.
struct Fitted {
    text: String,
}

impl Fitted {
    fn all(size: f64) -> Vec<Self> {
        let half = size / 2.0;
        let (small, large) = (1e-6, 1e6);
        [
            format!(r#"{{ "cone": {{ "radius": {size}, "height": {small} }} }}"#),
            format!(r#"{{ "cone": {{ "radius": {small}, "height": {size} }} }}"#),
            format!(r#"{{ "round_cone": {{ "bottom_radius": {size}, "top_radius": {small}, "height": {large} }} }}"#),
            format!(r#"{{ "round_cone": {{ "bottom_radius": {size}, "top_radius": {size}, "height": {} }} }}"#, 2.0 * size),
            format!(r#"{{ "ellipsoid": {{ "radii": [{size}, {small}, {large}] }} }}"#),
            format!(r#"{{ "ellipsoid": {{ "radii": [{size}, {size}, {size}] }} }}"#),
            format!(r#"{{ "vesica": {{ "a": [0, {size}, 0], "b": [{size}, 0, 0], "radius": {small} }} }}"#),
            format!(r#"{{ "vesica": {{ "a": [0, {size}, 0], "b": [0, -{size}, 0], "radius": {size} }} }}"#),
            format!(r#"{{ "death_star": {{ "radius": {size}, "bite": {large}, "distance": {large} }} }}"#),
            format!(r#"{{ "cut_sphere": {{ "radius": {size}, "cut": {half} }} }}"#),
            format!(r#"{{ "bezier_tube": {{ "a": [0, 0, 0], "b": [{size}, 0, 0], "c": [0, {small}, 0], "radius": {small} }} }}"#),
            format!(r#"{{ "bezier_tube": {{ "a": [{size}, 0, 0], "b": [{size}, 0, 0], "c": [{size}, 0, 0], "radius": {size} }} }}"#),
            format!(r#"{{ "triangle": {{ "a": [{size}, 0, 0], "b": [{size}, 0, 0], "c": [{size}, 0, 0], "radius": {size} }} }}"#),
            format!(r#"{{ "triangle": {{ "a": [{size}, 0, 0], "b": [0, {size}, 0], "c": [0, 0, {small}], "radius": {small} }} }}"#),
        ]
        .into_iter()
        .map(|text| Self { text })
        .collect()
    }
}

/// The errors of a job with one shape: pointer in the shape, and message.
fn faults(shape: &str) -> Vec<(String, String)> {
    let job = format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }}, "objects": [ {{ "shape": {shape} }} ] }},
        "image": {{ "width": 8, "height": 8 }} }}"#
    );
    match scene::parse(job.as_bytes()) {
        Ok(_) => Vec::new(),
        Err(scene::ParseError::Invalid(faults)) => faults
            .into_iter()
            .map(|fault| (fault.pointer.trim_start_matches("/scene/objects/0/shape/").to_owned(), fault.message))
            .collect(),
        Err(other) => panic!("{shape}: {other}"),
    }
}

#[test]
fn inconsistent_numbers_are_rejected_with_a_fix() {
    for (shape, pointer, cure) in [
        (r#"{ "box": { "size": [1, 2, 3], "round": 0.6 } }"#, "box/round", "make round 0.5 or less"),
        (r#"{ "torus": { "radius": 0.5, "tube": 0.5 } }"#, "torus/tube", "make tube less than 0.5"),
        (
            r#"{ "capped_torus": { "radius": 0.5, "tube": 0.6, "degrees": 90 } }"#,
            "capped_torus/tube",
            "make tube less than 0.5",
        ),
        (r#"{ "link": { "height": 3, "radius": 0.5, "tube": 0.7 } }"#, "link/tube", "make tube less than 0.5"),
        (r#"{ "link": { "height": 1, "radius": 0.5, "tube": 0.25 } }"#, "link/height", "make height 1.5 or more"),
        (
            r#"{ "capped_cone": { "bottom_radius": 0, "top_radius": 0, "height": 1 } }"#,
            "capped_cone/bottom_radius",
            "larger than 0",
        ),
        (
            r#"{ "round_cone": { "bottom_radius": 1, "top_radius": 0.5, "height": 1.5 } }"#,
            "round_cone/height",
            "make height 2 or more",
        ),
        (
            r#"{ "rounded_cylinder": { "radius": 1, "height": 0.5, "round": 0.5 } }"#,
            "rounded_cylinder/round",
            "make round 0.25 or less",
        ),
        (r#"{ "cut_sphere": { "radius": 1, "cut": -1 } }"#, "cut_sphere/cut", "between -1 and 1"),
        (
            r#"{ "cut_hollow_sphere": { "radius": 1, "cut": 1.5, "thickness": 0.1 } }"#,
            "cut_hollow_sphere/cut",
            "between -1 and 1",
        ),
        (
            r#"{ "cut_hollow_sphere": { "radius": 1, "cut": 0.5, "thickness": 2 } }"#,
            "cut_hollow_sphere/thickness",
            "make thickness less than 2",
        ),
        (
            r#"{ "death_star": { "radius": 1, "bite": 0.5, "distance": 2 } }"#,
            "death_star/distance",
            "between 0.5 and 1.5",
        ),
        (r#"{ "vesica": { "a": [0, 1, 0], "b": [0, 1, 0], "radius": 1 } }"#, "vesica/b", "at different points"),
        (
            r#"{ "vesica": { "a": [0, 1, 0], "b": [0, 0, 0], "radius": 1 } }"#,
            "vesica/radius",
            "make radius 0.5 or less",
        ),
        (r#"{ "u": { "radius": 0.5, "leg": 1, "width": 1, "thickness": 1 } }"#, "u/width", "make width less than 1"),
        (
            r#"{ "horseshoe": { "radius": 0.5, "degrees": 300, "leg": 1, "width": 0.1, "thickness": 1 } }"#,
            "horseshoe/leg",
            "make degrees, leg or width less",
        ),
        (
            r#"{ "quad": { "a": [0, 0, 0], "b": [1, 0, 0], "c": [1, 1, 0], "d": [0, 1, 0.5], "radius": 0.1 } }"#,
            "quad/d",
            "put it at [",
        ),
        (
            r#"{ "quad": { "a": [0, 0, 0], "b": [1, 1, 0], "c": [1, 0, 0], "d": [0, 1, 0], "radius": 0.1 } }"#,
            "quad/b",
            "order the corners",
        ),
        (r#"{ "infinite_cone": { "degrees": 90 } }"#, "infinite_cone/degrees", "from 0.1 to 89.9 degrees"),
    ] {
        let [(place, message)] = &faults(shape)[..] else { panic!("{shape} has {:?}", faults(shape)) };
        assert_eq!(place, pointer, "{shape}: {message}");
        assert!(message.contains(cure), "{shape}: {message}");
    }
}

#[test]
fn applying_the_fix_of_a_quad_makes_it_flat() {
    let quad = |d: &str| {
        faults(&format!(
            r#"{{ "quad": {{ "a": [0, 0, 0], "b": [1, 0.2, 0], "c": [1.5, 1.1, 0.3], "d": {d}, "radius": 0.1 }} }}"#
        ))
    };
    let message = quad("[0, 1, 0.5]").pop().expect("it is not flat").1;
    let (from, to) = (message.find('[').unwrap(), message.find(']').unwrap());
    assert_eq!(quad(&message[from..=to]), []);
}
