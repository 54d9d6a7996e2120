//! Contract tests that every node must pass, run on each node's own examples. No test names a node.

use crate::subject as scene;
use scene::nodes::{Exactness, Example, Node};
use scene::real::{Interval, Real, Tribool, Vec3, vec3};

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

fn each_node(mut check: impl FnMut(&str, &Node)) {
    for Example { kind, index: number, json: node, .. } in
        Node::examples().into_iter().filter(|example| crate::is_tested(example.kind))
    {
        check(&format!("{kind} {number}"), &serde_json::from_str(&node).expect("an example is a node"));
    }
}

#[test]
fn a_node_survives_a_json_round_trip() {
    each_node(|kind, node| {
        let text = serde_json::to_string(node).unwrap();
        assert_eq!(&serde_json::from_str::<Node>(&text).unwrap(), node, "{kind}");
    });
}

#[test]
fn the_schema_describes_every_node_and_each_of_its_keys() {
    let schema = scene::schema();
    for Example { kind, json: node, .. } in Node::examples() {
        let definition = &schema["$defs"][kind];
        assert!(definition["description"].is_string(), "{kind} has no description");
        assert_eq!(definition["additionalProperties"], false, "{kind} takes unknown keys");
        let node: serde_json::Value = serde_json::from_str(&node).unwrap();
        let (_, value) = node.as_object().unwrap().iter().next().unwrap();
        for key in value.as_object().unwrap().keys() {
            assert!(definition["properties"][key]["description"].is_string(), "{kind}.{key} has no description");
        }
    }
}

#[test]
fn distances_are_finite_everywhere() {
    each_node(|kind, node| {
        let mut random = Random(1);
        for reach in [0.0, 1e-6, 1.0, 10.0, 1e3, 1e6] {
            for _ in 0..2_000 {
                let p = random.point(reach);
                assert!(node.distance(p).is_finite(), "{kind} at {p:?}");
            }
        }
    });
}

#[test]
fn an_interval_contains_every_distance_inside_its_box() {
    each_node(|kind, node| {
        let mut random = Random(2);
        for round in 0..2_000 {
            let (corner, edge) = (random.point(2.5), [2.0, 0.5, 0.05, 1e-3][round % 4]);
            let ends = |low: f32| Interval::new(low, low + edge);
            let range: Interval = node.distance(vec3(ends(corner.x), ends(corner.y), ends(corner.z)));
            for _ in 0..16 {
                let within = |low: f32, random: &mut Random| random.next(low, low + edge).clamp(low, low + edge);
                let p =
                    vec3(within(corner.x, &mut random), within(corner.y, &mut random), within(corner.z, &mut random));
                let d = node.distance(p);
                assert!(range.contains(d), "{kind}: {d} at {p:?} is not in {range:?}");
            }
        }
    });
}

#[test]
fn no_step_passes_a_surface() {
    each_node(|kind, node| {
        let mut random = Random(3);
        let mut steps = 0;
        while steps < 20_000 {
            let p = random.point(3.0);
            let step = node.distance(p) / node.lipschitz();
            if step <= 0.0 {
                continue;
            }
            let q = random.direction().mul_add(step * random.next(0.0, 0.999), p);
            let d = node.distance(q);
            assert!(d > -1e-5, "{kind}: a step of {step} from {p:?} may reach {q:?}, which is {d} inside");
            steps += 1;
        }
    });
}

#[test]
fn distances_change_within_the_lipschitz_factor() {
    check_lipschitz_factors(5_000);
}

#[test]
#[ignore = "long: twenty times as many points; 12 s"]
fn distances_change_within_the_lipschitz_factor_at_many_points() {
    check_lipschitz_factors(100_000);
}

fn check_lipschitz_factors(points: u32) {
    each_node(|kind, node| {
        // An estimate is not a distance inside a fractal and at its fringe; there it only matters that no step passes
        // the surface.
        if node.exactness() == Exactness::Estimate {
            return;
        }
        let mut random = Random(4);
        for _ in 0..points {
            let (p, size) = (random.point(2.5), random.next(0.0, 1.0));
            let q = random.direction().mul_add(size * size * size, p);
            let (dp, dq) = (node.distance(p), node.distance(q));
            let apart = vec3(p.x - q.x, p.y - q.y, p.z - q.z).length();
            let rounding = 8.0 * f32::EPSILON * 4.0;
            assert!((dp - dq).abs() <= node.lipschitz() * apart + rounding, "{kind}: {dp} at {p:?}, {dq} at {q:?}");
        }
    });
}

/// Remaining distance to the surface after a step of the value's length, along the best of some gradients around `p`:
/// at a ridge of the distance a single gradient is not representative.
fn miss(node: &Node, p: Vec3<f32>, random: &mut Random) -> f32 {
    let distance = node.distance(p);
    let mut least = f32::INFINITY;
    for tried in 0..24 {
        let size = [1e-3, 4e-3, 2e-2][tried % 3];
        let near = if tried < 3 { p } else { random.direction().mul_add(size, p) };
        let slope = |step: Vec3<f32>| node.distance(near + step) - node.distance(near - step);
        let gradient = vec3(slope(vec3(size, 0.0, 0.0)), slope(vec3(0.0, size, 0.0)), slope(vec3(0.0, 0.0, size)));
        if gradient.length() > 0.0 {
            let foot = gradient.normalize().mul_add(-distance, p);
            least = least.min(node.distance(foot).abs());
        }
    }
    least
}

#[test]
fn an_exact_distance_ends_on_the_surface() {
    check_exact_distances(200);
}

#[test]
#[ignore = "long: fifteen times as many points; 12 s"]
fn an_exact_distance_ends_on_the_surface_at_many_points() {
    check_exact_distances(3_000);
}

fn check_exact_distances(points: u32) {
    each_node(|kind, node| {
        if node.exactness() != Exactness::Exact {
            return;
        }
        assert!(node.lipschitz() <= 1.0, "{kind} is exact: a distance has a Lipschitz factor of 1");
        let mut random = Random(5);
        for _ in 0..points {
            let p = random.point(2.0);
            let mut miss = miss(node, p, &mut random);
            // If many directions are equally near, search for the best of them.
            let distance = node.distance(p);
            let (mut nearest, mut best) = (f32::INFINITY, random.direction());
            for round in 0..4_000 {
                if miss <= 1e-3 {
                    break;
                }
                let spread = [1.0, 0.3, 0.1, 0.03, 0.01, 0.003][round % 6];
                let direction = (best + random.direction() * spread).normalize();
                let there = node.distance(direction.mul_add(distance.abs(), p)).abs();
                if there < nearest {
                    (nearest, best) = (there, direction);
                    miss = miss.min(there);
                }
            }
            assert!(miss <= 1e-3, "{kind}: {distance} at {p:?}, but {miss} is left from there to the surface");
        }
    });
}

#[test]
fn conditions_over_boxes_follow_three_valued_logic() {
    let box_of = |low, high| Interval::new(low, high);
    assert_eq!(box_of(0.0, 1.0).lt(box_of(2.0, 3.0)), Tribool::True);
    assert_eq!(box_of(2.0, 3.0).lt(box_of(0.0, 1.0)), Tribool::False);
    assert_eq!(box_of(0.0, 2.0).lt(box_of(1.0, 3.0)), Tribool::Unknown);
    assert_eq!(Tribool::Unknown & Tribool::False, Tribool::False);
    assert_eq!(Tribool::Unknown | Tribool::True, Tribool::True);
    assert_eq!(!Tribool::Unknown, Tribool::Unknown);
}

#[test]
fn bounds_contain_every_point_near_the_shape() {
    each_node(|name, node| {
        let mut random = Random(11);
        for level in [0.0, 0.1, 0.7] {
            let bounds = node.bounds(level);
            for _ in 0..20_000 {
                let p = random.point(3.0);
                let inside = [
                    (p.x, bounds.min.x, bounds.max.x),
                    (p.y, bounds.min.y, bounds.max.y),
                    (p.z, bounds.min.z, bounds.max.z),
                ]
                .iter()
                .all(|&(c, low, high)| (low - 1e-5..=high + 1e-5).contains(&c));
                let distance = node.distance(p);
                assert!(inside || distance > level, "{name} is {distance} away from {p:?}, outside {bounds:?}");
            }
        }
    });
}
