//! Contract tests of estimates, run on each such node's own examples: on no ray does a step of value/lipschitz pass a
//! piece of the fractal that small steps find.

use scene::nodes::{Exactness, Example, Node};
use scene::real::{Vec3, vec3};

/// Pseudorandom numbers from a fixed seed, so that failures repeat.
struct Random(u32);

impl Random {
    fn next(&mut self, low: f32, high: f32) -> f32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((self.0 >> ((self.0 >> 28) + 4)) ^ self.0).wrapping_mul(277_803_737);
        low + (high - low) * (((word >> 22) ^ word) >> 8) as f32 / (1 << 24) as f32
    }

    fn direction(&mut self) -> Vec3<f32> {
        loop {
            let v = vec3(self.next(-1.0, 1.0), self.next(-1.0, 1.0), self.next(-1.0, 1.0));
            if (0.01..=1.0).contains(&v.length()) {
                return v.normalize();
            }
        }
    }
}

/// The small step: pieces are at least as thick.
const STEP: f32 = 1e-3;
/// Small steps along a ray.
const STEPS: usize = 4_000;

/// Tolerance of a march at distance `t`.
fn tolerance(t: f32) -> f32 {
    2.5e-4 * t.max(0.1)
}

/// The published estimate of the Mandelbulb ignores its poles: marches pass the test, single values do not.
const CLAIMS_TOO_MUCH: &[&str] = &["Mandelbulb 0"];

/// A ray from outside toward the central half of a node.
fn ray(random: &mut Random) -> impl Fn(f32) -> Vec3<f32> + use<> {
    let origin = random.direction() * 2.0;
    let aim = random.direction() * random.next(0.0, 1.1);
    let direction = (aim - origin).normalize();
    move |t| direction.mul_add(t, origin)
}

fn each_estimate(mut check: impl FnMut(&str, &Node)) {
    for Example { kind, index: number, json: node, .. } in Node::examples() {
        let node: Node = serde_json::from_str(&node).expect("an example is a node");
        if node.exactness() == Exactness::Estimate {
            check(&format!("{kind} {number}"), &node);
        }
    }
}

#[test]
fn no_value_exceeds_the_distance_found_by_small_steps() {
    each_estimate(|name, node| {
        if CLAIMS_TOO_MUCH.contains(&name) {
            return;
        }
        let mut random = Random(21);
        for _ in 0..400 {
            let at = ray(&mut random);
            let mut values: Vec<f32> = Vec::with_capacity(STEPS);
            let mut is_found = false;
            for step in 0..STEPS {
                let value = node.distance(at(step as f32 * STEP));
                // A piece is at least two small steps long.
                is_found = value < 0.0 && values.last().is_some_and(|last| *last < 0.0);
                if is_found {
                    break;
                }
                values.push(value);
            }
            let free = if is_found { values.len() } else { 0 };
            for (step, value) in values[..free].iter().enumerate() {
                let left = (free - step) as f32 * STEP;
                let place = at(step as f32 * STEP);
                assert!(
                    value / node.lipschitz() <= left + STEP,
                    "{name} claims {value} at {place:?}, but a piece is {left} away and the stretch is {}",
                    node.lipschitz()
                );
            }
        }
    });
}

#[test]
fn no_march_jumps_over_a_piece_that_small_steps_find() {
    each_estimate(|name, node| {
        let mut random = Random(22);
        for _ in 0..400 {
            let at = ray(&mut random);
            let mut t = 0.0_f32;
            while t < STEPS as f32 * STEP {
                let step = node.distance(at(t)) / node.lipschitz();
                if step < tolerance(t) {
                    break;
                }
                let mut inside = 0;
                for small in (t / STEP).ceil() as usize..=((t + step) / STEP) as usize {
                    let value = node.distance(at(small as f32 * STEP));
                    inside = if value < 0.0 { inside + 1 } else { 0 };
                    assert!(
                        inside < 2,
                        "{name}: a step of {step} from {:?} passes {:?}",
                        at(t),
                        at(small as f32 * STEP)
                    );
                }
                t += step;
            }
        }
    });
}
