//! Motion blur: a blurred frame has the bits of its samples, each at its own instant, on every path.

use proto::Rect;
use scene::{Integrator, Job};
use serde_json::{Value, json};
use worker::cuda::KernelSource;
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TilePixels, TileRequest};

use crate::lanes::levels;

const WIDTH: u32 = 20;
const HEIGHT: u32 = 12;

/// A blurred job of three frames.
fn job(scene: &Value, samples: u32) -> Job {
    let text = json!({ "scene": scene, "frames": { "count": 3, "fps": 1, "shutter": 0.6 },
        "image": { "width": WIDTH, "height": HEIGHT, "samples": samples, "format": "exr", "layers": ["depth", "object"] } });
    scene::parse(text.to_string().as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}: {text}"))
}

/// Scenes whose shapes, camera or lights move: one is rendered by cells.
fn scenes() -> Vec<Value> {
    let moves = json!({ "keys": [[0, -1], [2, 1]] });
    let ball = |x: &Value| json!({ "translate": { "by": [x, 0, 0], "child": { "sphere": { "radius": 0.6 } } } });
    let scene = |shape: Value, x: &Value, integrator: Value| {
        json!({ "camera": { "position": [x, 1.2, 4], "look_at": [0, 0, 0] }, "integrator": integrator,
            "lights": [{ "sphere": { "position": [x, 2, 2], "radius": 0.4, "color": [5, 5, 5] } }],
            "objects": [{ "shape": shape, "material": { "surface": { "roughness": 0.3 } } },
                { "shape": { "plane": { "normal": [0, 1, 0], "offset": -0.7 } } }] })
    };
    let many = json!({ "translate": { "by": [moves, 0, 0], "child": { "union": { "of":
        (0..300).map(|index| {
            let (x, z) = (f64::from(index % 20) * 0.2 - 2.0, f64::from(index / 20) * 0.2 - 2.0);
            json!({ "translate": { "by": [x, -0.5, z], "child": { "sphere": { "radius": 0.08 } } } })
        }).collect::<Vec<_>>() } } } });
    let path = || json!({ "path": { "max_bounces": 2 } });
    vec![
        scene(ball(&moves), &json!(0.5), json!("direct")),
        scene(ball(&json!(0)), &moves, path()),
        scene(many, &json!(0.5), path()),
    ]
}

/// Pixels of frame 1.
pub(crate) fn render(renderer: &CpuRenderer, job: &Job, rect: Rect) -> TilePixels {
    let run = TileRequest { job, frame: 1, rect };
    renderer.render(&run, &CancelFlag::new(), &|_| ()).expect("it renders")
}

pub(crate) fn bits(planes: &[Vec<f32>]) -> Vec<u32> {
    planes.iter().flatten().map(|value| value.to_bits()).collect()
}

/// The numbers of a rectangle, from planes of this width and height.
pub(crate) fn part(planes: &[u32], [width, height]: [u32; 2], rect: Rect) -> Vec<u32> {
    let rows = (rect.y..rect.y + rect.height).flat_map(|y| (rect.x..rect.x + rect.width).map(move |x| (x, y)));
    let places: Vec<usize> = rows.map(|(x, y)| (y * width + x) as usize).collect();
    let planes = planes.chunks_exact((width * height) as usize);
    planes.flat_map(|plane| places.iter().map(|&place| plane[place])).collect()
}

/// Pixels of frame 1, by the definition.
fn defined(job: &Job) -> Vec<Vec<f32>> {
    let exposure = job.exposure(1).expect("a valid frame");
    let integrators: Vec<Integrator<'_>> = exposure.instants.iter().map(Integrator::new).collect();
    let last = integrators.last().expect("a frame has an instant");
    let mut planes = vec![Vec::new(); 6];
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x as f32, y as f32))) {
        let parts = integrators.iter().zip(exposure.samples().concat());
        let sum = parts.fold(last.no_light(0.0), |sum, (integrator, samples)| {
            integrator.accumulate(x, y, samples.start as f32, samples.end as f32, sum)
        });
        let (mean, layers) = (last.mean(sum), last.layer_values(x, y));
        let channels = [mean.color.x, mean.color.y, mean.color.z, mean.alpha, layers.depth, layers.object];
        planes.iter_mut().zip(channels).for_each(|(plane, value)| plane.push(value + 0.0));
    }
    planes
}

#[test]
fn a_blurred_frame_has_the_same_bits_on_every_path_and_in_tiles() {
    for scene in scenes() {
        let blurred = job(&scene, 8);
        let whole = Rect::full(WIDTH, HEIGHT);
        let reference = CpuRenderer::new(Some(1), Simd::Scalar).expect("it renders");
        let want = bits(&render(&reference, &blurred, whole).planes);
        // Cells change the steps of rays.
        if !reference.has_cells(&blurred, 1).expect("a valid frame") {
            assert_eq!(bits(&defined(&blurred)), want, "{scene}");
        }
        for level in levels() {
            let renderer = CpuRenderer::new(Some(2), level).expect("a level of this CPU");
            assert_eq!(bits(&render(&renderer, &blurred, whole).planes), want, "{level}: {scene}");
        }
        // As much memory for cells as some of the tile's instants need.
        let small = CpuRenderer::new(Some(2), Simd::Auto).expect("it renders").with_cell_memory(1 << 20);
        assert_eq!(bits(&render(&small, &blurred, whole).planes), want, "{scene}");
        let (rect, renderer) =
            (Rect { x: 7, y: 5, width: 9, height: 6 }, CpuRenderer::new(Some(1), Simd::Auto).unwrap());
        let tile = render(&renderer, &blurred, rect);
        assert_eq!(bits(&tile.planes), part(&want, [WIDTH, HEIGHT], rect), "{scene}");
    }
}

#[test]
fn the_instants_of_a_frame_share_one_kernel_source() {
    for scene in scenes() {
        let blurred = job(&scene, 8);
        let exposure = blurred.exposure(1).expect("a valid frame");
        let sources: Vec<_> = exposure.instants.iter().map(|at_frame| KernelSource::new(at_frame).unwrap()).collect();
        assert!(sources.windows(2).all(|pair| pair[0].text == pair[1].text), "{scene}");
        assert!(sources.windows(2).any(|pair| pair[0].parameters != pair[1].parameters), "{scene}");
    }
}
