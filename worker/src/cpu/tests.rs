//! Tests of the renderer that see its cells.

use std::sync::atomic::{AtomicU64, Ordering};

use proto::Rect;

use super::*;
use crate::evaluators::cells::many;

fn render(renderer: &CpuRenderer, job: &Job) -> Result<(TilePixels, u64), RenderError> {
    let run = TileRequest { job, frame: 0, rect: Rect::full(job.image.film().width, job.image.film().height) };
    let rays = AtomicU64::new(0);
    let count = |newly| {
        rays.fetch_add(newly, Ordering::Relaxed);
    };
    let pixels = renderer.render(&run, &CancelFlag::new(), &count)?;
    Ok((pixels, rays.into_inner()))
}

#[test]
fn cells_that_do_not_fit_are_made_again() {
    let job = scene::parse(many(3000).as_bytes()).expect("a valid job");
    let job = job.clone().with_image(scene::ImageSpec { width: 32, height: 160, samples: 1.into(), ..job.image });
    for simd in [Simd::Auto, Simd::Portable] {
        let renderer = CpuRenderer::new(Some(2), simd).expect("threads");
        let (pixels, rays) = render(&renderer, &job).expect("it has room");
        let exposure = job.exposure(0).expect("a valid frame");
        let kernel = renderer.kernel(&exposure).expect("a valid tape");
        let bytes = kernel.tables()[0].used() * size_of::<u32>();
        let limited = |bytes| render(&CpuRenderer::new(Some(2), simd).expect("threads").with_cell_memory(bytes), &job);
        for percent in [90, 80] {
            let limited = limited(bytes * percent / 100);
            let (got, reported) = limited.unwrap_or_else(|error| panic!("{percent} %, {simd}: {error}"));
            assert!(got == pixels, "with {percent} % of the memory, {simd}, the pixels differ");
            assert_eq!(reported, rays, "each ray is reported once");
        }
        let refused = limited(100).expect_err("a single cell has no room").to_string();
        assert!(refused.contains("--cell-memory"), "{refused}");
    }
}

/// Job of shapes with cells and a camera that turns, in three frames, with this text in place of the first shape.
fn turning(first: &str) -> Job {
    let shapes = many(300).replacen(r#""of": ["#, &format!(r#""of": [{first}, "#), 1);
    let shapes = shapes.replacen(r#""look_at": [0, 0, 0]"#, r#""look_at": [0, 0, 0], "turntable": { "turns": 1 }"#, 1);
    let mut job: serde_json::Value = serde_json::from_str(&shapes).expect("JSON");
    job["frames"] = serde_json::json!({ "count": 3, "fps": 10 });
    job["image"] = serde_json::json!({ "width": 32, "height": 32 });
    scene::parse(job.to_string().as_bytes()).unwrap_or_else(|errors| panic!("{errors}"))
}

#[test]
fn frames_share_cells_while_no_shape_moves() {
    let constant = r#"{ "sphere": { "radius": 0.5 } }"#;
    let moving = r#"{ "sphere": { "radius": { "keys": [[0, 0.5], [0.3, 0.9]] } } }"#;
    for (first, is_shared) in [(constant, true), (moving, false)] {
        let (job, kept) = (turning(first), CpuRenderer::new(Some(2), Simd::Auto).expect("threads"));
        let table = |frame: u32| {
            let exposure = job.exposure(frame).expect("a valid frame");
            Arc::as_ptr(kept.kernel(&exposure).expect("a valid tape").tables()[0])
        };
        let first_table = table(0);
        for frame in 0..3 {
            let run = TileRequest { job: &job, frame, rect: Rect::full(32, 32) };
            let render =
                |renderer: &CpuRenderer| renderer.render(&run, &CancelFlag::new(), &|_| ()).expect("it renders");
            let alone = render(&CpuRenderer::new(Some(2), Simd::Auto).expect("threads"));
            assert!(render(&kept) == alone, "frame {frame} differs");
            assert_eq!(table(frame) == first_table, is_shared || frame == 0, "in frame {frame} with {first}");
        }
    }
}
