//! The paper's figures against the paper's own march, reimplemented here in double precision: the same geometry
//! gives the same silhouettes, to half a pixel.
#![expect(clippy::disallowed_methods, reason = "this is the paper's arithmetic, and renders no picture")]

use std::path::Path;

use proto::Rect;
use scene::real::vec3;
use serde_json::{Value, json};
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TileRequest};

/// Pixels along an edge.
const SIZE: usize = 256;
/// Minimum step of the paper.
const MIN_STEP: f64 = 0.001;
/// Hit tolerance, which the paper does not give.
const NEAR: f64 = 1e-4;
/// Maximum distance of its rays.
const FAR: f64 = 1000.0;

type Point = [f64; 3];
/// Name of a figure, its field of view if it is not the default, and its distance function.
type Figure = (&'static str, Option<f64>, fn(Point) -> f64);

fn less(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn length(v: Point) -> f64 {
    v.iter().map(|part| part * part).sum::<f64>().sqrt()
}

fn along(start: Point, direction: Point, t: f64) -> Point {
    [start[0] + t * direction[0], start[1] + t * direction[1], start[2] + t * direction[2]]
}

fn scaled(v: Point, by: f64) -> Point {
    v.map(|part| part * by)
}

fn cross(a: Point, b: Point) -> Point {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn sphere(p: Point, center: Point, radius: f64) -> f64 {
    length(less(p, center)) - radius
}

/// |max(q,0)| + min(max(qx,qy,qz),0), q = |p|−B.
fn block(p: Point, center: Point, half_edges: Point) -> f64 {
    let q = less(less(p, center).map(f64::abs), half_edges);
    length(q.map(|part| part.max(0.0))) + q[0].max(q[1]).max(q[2]).min(0.0)
}

/// z → zⁿ + p in polar form, and ½·ln(r)·r/dr.
fn mandelbulb(p: Point) -> f64 {
    const POWER: f64 = 8.0;
    let (mut z, mut growth) = (p, 1.0);
    for _ in 0..8 {
        let r = length(z);
        if r > 2.0 {
            break;
        }
        growth = POWER * r.powf(POWER - 1.0) * growth + 1.0;
        let (theta, phi) = ((z[2] / r).acos() * POWER, z[1].atan2(z[0]) * POWER);
        let direction = [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()];
        z = along(p, direction, r.powf(POWER));
    }
    let r = length(z);
    0.5 * r.ln() * r / growth
}

/// The five shapes of the first figure. The lattice of Perlin's noise is random, so sdfarm's is used.
fn teaser(p: Point) -> f64 {
    let noise: scene::noise::Noise = serde_json::from_value(json!({ "perlin": { "scale": 5 } })).expect("a noise");
    let rough = sphere(p, [-2.7, 0.0, -8.0], 1.25);
    let noisy = if rough > 0.2 {
        rough - 0.11
    } else {
        rough - 0.1 * f64::from(noise.value(vec3(p[0] as f32, p[1] as f32, p[2] as f32)))
    };
    let waves = 0.05 * p.map(|part| (9.0 * part).sin()).iter().product::<f64>();
    let window = sphere(p, [0.0, 0.0, -7.0], 1.25).max(-block(p, [0.0, 0.0, -6.5], [0.75, 0.75, 2.0]));
    [sphere(p, [-5.4, 0.0, -9.0], 1.25), noisy, window, sphere(p, [2.7, 0.0, -8.0], 1.25) + waves]
        .into_iter()
        .fold(sphere(p, [5.4, 0.0, -9.0], 1.25), f64::min)
}

fn clouds(p: Point) -> f64 {
    let centers = [-2.1, 2.1].map(|x| [-2.1, 2.1].map(|y| [x, y, -5.0]));
    centers.into_iter().flatten().map(|center| sphere(p, center, 2.0)).fold(f64::INFINITY, f64::min)
}

/// t = 0; near zero: hit; else t += max(D, 0.001).
fn is_hit(start: Point, direction: Point, distance: fn(Point) -> f64) -> bool {
    let mut t = 0.0;
    while t < FAR {
        let gap = distance(along(start, direction, t));
        if gap < NEAR {
            return true;
        }
        t += gap.max(MIN_STEP);
    }
    false
}

/// The paper's renderer, pointed at a figure.
struct Paper {
    position: Point,
    /// Forward vector, and the vectors to half a picture to the right and up.
    axes: [Point; 3],
    distance: fn(Point) -> f64,
}

impl Paper {
    fn new(job: &Value, distance: fn(Point) -> f64) -> Self {
        let camera = &job["scene"]["camera"];
        let number = |value: &Value| value.as_f64().expect("a number");
        let point = |value: &Value| [number(&value[0]), number(&value[1]), number(&value[2])];
        let (position, target) = (point(&camera["position"]), point(&camera["look_at"]));
        let normal = |v: Point| scaled(v, 1.0 / length(v));
        let forward = normal(less(target, position));
        let right = normal(cross(forward, [0.0, 1.0, 0.0]));
        let half = (number(&camera["fov"]).to_radians() / 2.0).tan();
        let axes = [forward, scaled(right, half), scaled(cross(right, forward), half)];
        Self { position, axes, distance }
    }

    /// Whether the ray this many pixels from the left and the top hits.
    fn hits(&self, x: f64, y: f64) -> bool {
        let [forward, right, up] = self.axes;
        let place = |pixels: f64| pixels / SIZE as f64 * 2.0 - 1.0;
        let direction = along(along(forward, right, place(x)), up, -place(y));
        is_hit(self.position, scaled(direction, 1.0 / length(direction)), self.distance)
    }

    /// Whether a ray at most half a pixel from the middle of this pixel has the outcome `got`.
    fn allows(&self, index: usize, got: bool) -> bool {
        let (x, y) = ((index % SIZE) as f64, (index / SIZE) as f64);
        let mut places = (0..=8).flat_map(|row| (0..=8).map(move |column| (column, row)));
        places.any(|(column, row)| self.hits(x + f64::from(column) / 8.0, y + f64::from(row) / 8.0) == got)
    }
}

/// Pixels that sdfarm hits: flat colors on no background, one ray per pixel.
fn rendered(job: &Value) -> Vec<bool> {
    let job = scene::parse(job.to_string().as_bytes()).expect("the job is valid");
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("there is a CPU");
    let run = TileRequest { job: &job, frame: 0, rect: Rect::full(SIZE as u32, SIZE as u32) };
    let pixels = renderer.render(&run, &CancelFlag::new(), &|_| ()).expect("it renders");
    pixels.planes[3].iter().map(|&alpha| alpha > 0.5).collect()
}

/// A figure rendered as a silhouette, with a square's field of view.
fn figure(name: &str, fov: Option<f64>) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../scenes/paper/{name}.json"));
    let mut job: Value = serde_json::from_slice(&std::fs::read(path).expect("it is shipped")).expect("JSON");
    for object in job["scene"]["objects"].as_array_mut().expect("objects") {
        object["material"] = json!({ "flat": { "color": [0, 0, 0] } });
    }
    job["scene"]["background"] = json!("transparent");
    job["image"] = json!({ "width": SIZE, "height": SIZE, "samples": 1 });
    if let Some(fov) = fov {
        job["scene"]["camera"]["fov"] = json!(fov);
    }
    job
}

#[test]
fn silhouettes_match_the_papers_march_to_half_a_pixel() {
    let figures: [Figure; 3] =
        [("teaser", Some(90.0), teaser), ("clouds", None, clouds), ("mandelbulb", None, mandelbulb)];
    for (name, fov, distance) in figures {
        let job = figure(name, fov);
        let (paper, got) = (Paper::new(&job, distance), rendered(&job));
        let middle = |index: usize| paper.hits((index % SIZE) as f64 + 0.5, (index / SIZE) as f64 + 0.5);
        let want: Vec<bool> = (0..SIZE * SIZE).map(middle).collect();
        let hits = want.iter().filter(|&&hit| hit).count();
        let differing: Vec<usize> = (0..SIZE * SIZE).filter(|&index| want[index] != got[index]).collect();
        println!("{name}: {hits} pixels are hit, {} differ", differing.len());
        assert!(hits > 1000, "{name}: {hits} pixels are hit");
        let wrong: Vec<usize> = differing.into_iter().filter(|&index| !paper.allows(index, got[index])).collect();
        assert!(wrong.is_empty(), "{name}: {wrong:?} differ by more than half a pixel");
    }
}
