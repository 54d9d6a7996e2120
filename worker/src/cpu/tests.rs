//! Tests of the renderer that see its cells.

use std::sync::atomic::{AtomicU64, Ordering};

use proto::Rect;

use super::*;
use crate::cpu::evaluator::tests::cells::many;

fn render(renderer: &CpuRenderer, job: &Job) -> Result<(TilePixels, u64), RenderError> {
    let run = TileRequest { job, frame: 0, rect: Rect::full(job.image.width, job.image.height) };
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
    let job = job.clone().with_image(scene::Image { width: 32, height: 160, samples: 1, ..job.image });
    for simd in [Simd::Auto, Simd::Portable] {
        let renderer = CpuRenderer::new(Some(2), simd).expect("threads");
        let (pixels, rays) = render(&renderer, &job).expect("it has room");
        let still = job.at(0).expect("a valid frame");
        let kernel = renderer.kernel(&still).expect("a valid tape");
        let bytes = kernel.table().expect("cells").used() * size_of::<u32>();
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
