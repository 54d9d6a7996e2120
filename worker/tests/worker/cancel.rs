//! Cancelling a render on the CPU, however much work a single pixel is.

use std::sync::mpsc;
use std::time::Duration;

use proto::Rect;
use scene::Job;
use worker::{CancelFlag, CpuRenderer, RenderError, Renderer, Simd, TileRequest};

/// Deadline of a wait, sufficient on the slowest machine; the renders below would take minutes or longer.
const DEADLINE: Duration = Duration::from_secs(20);

/// A pixel of 65,536 samples: glass spheres in rows of 20, whose paths have up to 32 segments.
fn costly_pixel(spheres: u32) -> Job {
    let sphere = |number: u32| {
        let (x, y, z) = (number % 20, number / 20 % 20, number / 400);
        let at = [f64::from(x) - 9.6, f64::from(y) - 9.6, -f64::from(z)];
        format!(r#"{{ "translate": {{ "by": {at:?}, "child": {{ "sphere": {{ "radius": 0.48 }} }} }} }}"#)
    };
    let shapes: Vec<String> = (0..spheres).map(sphere).collect();
    let text = format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }}, "march": {{ "max_bounces": 32 }},
             "objects": [ {{ "material": {{ "surface": {{ "transmission": 1, "ior": 1.5 }} }},
                             "shape": {{ "union": {{ "of": [{}] }} }} }} ] }},
             "image": {{ "width": 1, "height": 1, "samples": 65536 }} }}"#,
        shapes.join(", ")
    );
    scene::parse(text.as_bytes()).expect("the job is valid")
}

#[test]
fn a_pixel_of_endless_work_stops_when_it_is_cancelled() {
    let job = costly_pixel(2000);
    for simd in crate::lanes::levels().filter(|&level| level != Simd::Scalar) {
        let renderer = CpuRenderer::new(Some(2), simd).expect("threads start");
        let (cancel, (sender, rendered)) = (CancelFlag::new(), mpsc::channel());
        let (own, job) = (cancel.clone(), job.clone());
        std::thread::spawn(move || {
            let run = TileRequest { job: &job, frame: 0, rect: Rect::full(1, 1) };
            sender.send(renderer.render(&run, &own, &|_| {})).expect("the test waits");
        });
        assert!(rendered.recv_timeout(Duration::from_millis(100)).is_err(), "it takes long");
        cancel.cancel();
        let rendered = rendered.recv_timeout(DEADLINE).expect("the render stops");
        assert!(matches!(rendered, Err(RenderError::Cancelled)), "{simd}");
    }
}

#[test]
fn a_cancel_stops_no_other_render() {
    let job = crate::fake_renderer::job(64, 48, r#""samples": 200"#);
    let renderer = CpuRenderer::new(Some(2), Simd::Auto).expect("threads start");
    let run = TileRequest { job: &job, frame: 0, rect: Rect::full(64, 48) };
    let undisturbed = renderer.render(&run, &CancelFlag::new(), &|_| {}).expect("it renders");
    let rays = std::sync::atomic::AtomicU64::new(0);
    let cancels_others = |finished| {
        rays.fetch_add(finished, std::sync::atomic::Ordering::Relaxed);
        CancelFlag::new().cancel();
    };
    let disturbed = renderer.render(&run, &CancelFlag::new(), &cancels_others).expect("it renders");
    assert!(disturbed == undisturbed, "the same bits");
    assert_eq!(rays.into_inner(), 64 * 48 * 200, "each ray is reported once");
}
