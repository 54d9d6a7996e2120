//! Depth of every shipped scene compared with the same formulas in double precision, marched in another way: no
//! relaxation, no tolerance, a root found by bisection.

use std::path::{Path, PathBuf};

use scene::real::{Vec3, vec3};
use scene::{Integrator, parse};

use super::double::Double;

/// Approximate number of pixels of a scene that are compared.
const PIXELS: f64 = 1500.0;
/// Maximum relative error of a depth.
const EXACT: f64 = 1e-4;
/// Minimum fraction of the pixels with that precision.
const MOST: f64 = 0.999;
/// Scenes close to a fractal, where single precision does not find the tip of each needle: a smaller fraction is
/// required.
const CLOSE: ([&str; 2], f64) = (["mandelbulb-close.json", "paper/mandelbulb.json"], 0.99);
/// Rounding error of distances of about 1 in single precision, after some hundred operations.
const RESOLUTION: f64 = 5e-7;
/// Maximum fraction of the pixels of any scene that single precision may leave undecided.
const UNCLEAR: f64 = 0.05;
/// Steps after which a ray of the witness stops, and its pixel is not compared.
const STEPS: u32 = 60_000;

/// A scene's distance along a ray, in double precision.
struct Witness<'a> {
    program: &'a Integrator<'a>,
    origin: Vec3<Double>,
    direction: Vec3<Double>,
}

impl Witness<'_> {
    fn value(&self, t: f64) -> f64 {
        self.program.distance(self.direction.mul_add(Double(t), self.origin)).0
    }

    /// Distance of the intersection: infinite if there is none; `None` if it takes too many steps.
    fn root(&self, farthest: f64) -> Option<f64> {
        let mut t = 0.0;
        for _ in 0..STEPS {
            let value = self.value(t);
            if value <= 0.0 {
                return Some(t);
            }
            let next = t + value.max(1e-6 * (t + 0.1));
            if next > farthest {
                return Some(f64::INFINITY);
            }
            if self.value(next) <= 0.0 {
                return Some(self.between(t, next));
            }
            t = next;
        }
        None
    }

    /// Whether single precision may confuse one depth with the other: at the nearer one, the surface is no deeper and
    /// no farther away than the error of the distance in single precision.
    fn is_unclear(&self, got: f64, want: f64) -> bool {
        let nearer = got.min(want);
        let around = (-20..=40).map(|step| nearer * (1.0 + 0.025 * EXACT * f64::from(step)));
        let (mut deepest, mut error) = (f64::MAX, RESOLUTION);
        for t in around {
            let value = self.value(t);
            let single = |v: Vec3<Double>| vec3(v.x.0 as f32, v.y.0 as f32, v.z.0 as f32);
            let p = single(self.direction).mul_add(t as f32, single(self.origin));
            deepest = value.min(deepest);
            error = (f64::from(self.program.distance(p)) - value).abs().max(error);
        }
        deepest.abs() < 2.0 * error
    }

    fn between(&self, mut outside: f64, mut inside: f64) -> f64 {
        for _ in 0..60 {
            let middle = 0.5 * (outside + inside);
            if self.value(middle) <= 0.0 {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        inside
    }
}

/// Number of compared pixels, of incorrect pixels, and of undecided pixels.
fn measure(path: &Path) -> (usize, usize, usize, String) {
    let text = std::fs::read(path).expect("a scene");
    let job = parse(&text).unwrap_or_else(|fault| panic!("{}: {fault:?}", path.display()));
    let at_frame = job.at(0).expect("a first frame");
    let program = Integrator::new(&at_frame);
    let (scene, image) = (at_frame.scene(), at_frame.image());
    let view = scene.camera.view(image.width, image.height);
    let farthest = f64::from(scene.march.max_distance.in_frame());
    let stride = (f64::from(image.width) * f64::from(image.height) / PIXELS).sqrt().round() as usize;
    let (mut looked, mut wrong, mut untold, mut examples) = (0, 0, 0, String::new());
    for y in (stride / 2..image.height as usize).step_by(stride) {
        for x in (stride / 2..image.width as usize).step_by(stride) {
            let ray = view.ray(Double(x as f64 + 0.5), Double(y as f64 + 0.5));
            let witness = Witness { program: &program, origin: ray.origin, direction: ray.direction };
            let Some(want) = witness.root(farthest) else {
                untold += 1;
                continue;
            };
            let got = f64::from(program.layer_values(x as f32, y as f32).depth);
            looked += 1;
            if got != want && (got - want).abs() >= EXACT * want {
                if witness.is_unclear(got, want) {
                    untold += 1;
                    continue;
                }
                wrong += 1;
                examples = format!("{examples} ({x}, {y}): {got} for {want};");
            }
        }
    }
    (looked, wrong, untold, examples)
}

fn scenes() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    let mut scenes = Vec::new();
    for folder in [root.clone(), root.join("paper")] {
        let files = std::fs::read_dir(&folder).expect("the scenes").map(|entry| entry.expect("a file").path());
        scenes.extend(files.filter(|path| path.extension().is_some_and(|extension| extension == "json")));
    }
    scenes.sort();
    scenes
}

#[test]
fn depth_of_every_scene_matches_double_precision() {
    let chosen = std::env::var("SDFARM_SCENE").unwrap_or_default();
    let scenes: Vec<PathBuf> = scenes().into_iter().filter(|path| path.to_string_lossy().contains(&chosen)).collect();
    let next = std::sync::atomic::AtomicUsize::new(0);
    let failures = std::sync::Mutex::new(Vec::new());
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(path) = scenes.get(next.fetch_add(1, std::sync::atomic::Ordering::Relaxed)) {
                    let (looked, wrong, untold, examples) = measure(path);
                    println!("{}: {wrong} of {looked} wrong, {untold} undecided;{examples}", path.display());
                    let is_close = CLOSE.0.iter().any(|name| path.ends_with(name));
                    let most = if is_close { CLOSE.1 } else { MOST };
                    let allowed = (looked as f64 * (1.0 - most)).ceil() as usize;
                    if wrong > allowed || untold as f64 > looked as f64 * UNCLEAR {
                        failures.lock().expect("no thread panicked").push(path.display().to_string());
                    }
                }
            });
        }
    });
    let failures = failures.into_inner().expect("no thread panicked");
    assert!(failures.is_empty(), "depth is incorrect in {failures:?}");
}
