//! Rendering one frame of a job to a file.

use std::io::Cursor;
use std::sync::atomic::{AtomicU64, Ordering};

use proto::Rect;
use scene::Job;
use worker::CancelFlag;
use worker::frame::{RenderFrameError, render_frame};
use worker::stitch::TileRows;

use crate::fake_renderer::FakeRenderer;
use crate::pictures::{encode, jobs, tiles};

fn render(job: &Job, tile_px: Option<u32>, cancel: &CancelFlag, rays: &AtomicU64) -> Result<Vec<u8>, RenderFrameError> {
    let scratch = tempfile::tempdir().unwrap();
    let mut out = Cursor::new(Vec::new());
    let progress = |more| _ = rays.fetch_add(more, Ordering::Relaxed);
    render_frame(&FakeRenderer, job, 3, tile_px, scratch.path(), &mut out, cancel, &progress)?;
    Ok(out.into_inner())
}

#[test]
fn a_frames_file_does_not_depend_on_its_tiles() {
    for job in jobs() {
        let whole = tiles(&job, &[Rect::full(job.image.width, job.image.height)]);
        let expected = encode(&job, &mut TileRows(&whole), 64).unwrap();
        for tile_px in [None, Some(1), Some(32), Some(96)] {
            let rays = AtomicU64::new(0);
            let got = render(&job, tile_px, &CancelFlag::new(), &rays).unwrap();
            assert_eq!(got, expected, "{tile_px:?}, {:?}", job.image);
            let asked = u64::from(job.image.width * job.image.height * job.image.samples.max());
            assert_eq!(rays.into_inner(), asked);
        }
    }
}

#[test]
fn a_cancelled_frame_returns_an_error() {
    let cancel = CancelFlag::new();
    cancel.cancel();
    let error = render(&jobs()[0], None, &cancel, &AtomicU64::new(0)).unwrap_err();
    assert!(error.is_cancelled(), "{error:?}");
}
