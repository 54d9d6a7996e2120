//! Delivery of results: blobs, pictures and errors.

use proto::Rect;
use proto::worker_protocol::{Batch, BatchWork, LeaseOutcome, StitchInput};
use proto::{JobId, LeaseId};
use scene::Job;
use worker::blob;
use worker::stitch::TileRows;

use super::{Acting, Agent, add_job};
use crate::fake_renderer::{ALL_LAYERS, FakeRenderer, cut, pixels};
use crate::fake_server::FakeServer;
use crate::pictures::{encode, tiles};
use axum::http::StatusCode;

fn expected(job: &Job) -> Vec<u8> {
    let whole = tiles(job, &[Rect::full(job.image.width, job.image.height)]);
    encode(job, &mut TileRows(&whole), 64).unwrap()
}

#[test]
fn a_complete_frame_is_delivered_as_a_picture() {
    let server = FakeServer::start(30_000);
    let mut agent = Agent::start(&server, FakeRenderer);
    for image in ["", r#""format": "exr""#] {
        let (id, job) = add_job(&server, 90, 70, image);
        let leases = server.change(|farm| farm.give(id, &cut(90, 70, 32, 32), true));
        for outcome in server.outcomes(&leases) {
            let LeaseOutcome::Picture { hash, size_bytes } = outcome else { panic!("{outcome:?}") };
            let picture = server.change(|farm| farm.pictures[&hash].clone());
            assert_eq!(picture.len() as u64, size_bytes);
            assert_eq!(picture, expected(&job));
        }
        let together = server.change(|farm| farm.syncs.iter().any(|sync| sync.reports.len() == leases.len()));
        assert!(together, "the leases of one picture are reported in one call");
    }
    agent.stop().unwrap();
}

#[test]
fn tiles_are_delivered_as_blobs_and_stitched() {
    let server = FakeServer::start(30_000);
    let mut agent = Agent::start(&server, FakeRenderer);
    let image = format!(r#""format": "exr", "layers": {ALL_LAYERS}"#);
    let (id, job) = add_job(&server, 90, 70, &image);
    let rects = cut(90, 70, 32, 32);
    let parts = render_to_blobs(&server, id, &job, &rects);
    let outcome = stitch(&server, id, parts);
    let LeaseOutcome::Picture { hash, .. } = outcome else { panic!("{outcome:?}") };
    assert_eq!(server.change(|farm| farm.pictures[&hash].clone()), expected(&job));
    assert_eq!(server.change(|farm| farm.jobs_read), 1, "a job's file is read once");
    agent.stop().unwrap();
}

fn render_to_blobs(server: &FakeServer, id: JobId, job: &Job, rects: &[Rect]) -> Vec<StitchInput> {
    let leases = server.change(|farm| farm.give(id, rects, false));
    let outcomes = server.outcomes(&leases);
    let parts = (0..).zip(rects).zip(outcomes).map(|((index, &rect), outcome)| {
        let LeaseOutcome::Blob { hash, size_bytes } = outcome else { panic!("{outcome:?}") };
        let bytes = server.change(|farm| farm.blobs[&hash].clone());
        assert_eq!(bytes, blob::encode(&pixels(job, 3, rect)));
        StitchInput { index, rect, hash, size_bytes }
    });
    parts.collect()
}

fn stitch(server: &FakeServer, job: JobId, parts: Vec<StitchInput>) -> LeaseOutcome {
    let lease = LeaseId::new();
    server.change(|farm| {
        farm.queue.push_back(Batch {
            job,
            frame: 3,
            tile_seconds: None,
            work: BatchWork::Stitch { lease, inputs: parts },
            recording: None,
        });
    });
    server.outcomes(&[lease]).remove(0)
}

#[test]
fn damaged_and_missing_blobs_are_reported() {
    let server = FakeServer::start(30_000);
    let mut agent = Agent::start(&server, FakeRenderer);
    let (id, job) = add_job(&server, 90, 70, "");
    let rects = cut(90, 70, 32, 32);
    let parts = render_to_blobs(&server, id, &job, &rects);
    server.change(|farm| {
        farm.blobs.get_mut(&parts[1].hash).unwrap()[100] ^= 1;
        farm.blobs.remove(&parts[3].hash);
        farm.blobs.get_mut(&parts[4].hash).unwrap().push(0);
        farm.blobs.get_mut(&parts[6].hash).unwrap().pop();
    });
    let outcome = stitch(&server, id, parts);
    let LeaseOutcome::BadBlobs { tiles } = outcome else { panic!("{outcome:?}") };
    assert_eq!(tiles, [1, 3, 4, 6]);
    agent.stop().unwrap();
}

#[test]
fn a_failing_tile_is_reported_with_its_message_alone() {
    let server = FakeServer::start(30_000);
    let renderer = Acting(|run: &worker::TileRequest<'_>, _: &worker::CancelFlag| {
        assert!(run.rect.x != 64, "no good at {}", run.rect.x);
        if run.rect.x == 32 {
            let (device, reason) = ("the card".to_owned(), "it is on fire".to_owned());
            return Err(worker::RenderError::Device { device, reason });
        }
        Ok(())
    });
    let mut agent = Agent::start(&server, renderer);
    let (id, _) = add_job(&server, 96, 32, "");
    for whole_frame in [true, false] {
        let leases = server.change(|farm| farm.give(id, &cut(96, 32, 32, 32), whole_frame));
        let outcomes = server.outcomes(&leases);
        assert!(matches!(outcomes[0], LeaseOutcome::Blob { .. }), "{outcomes:?}");
        let LeaseOutcome::Failed { message } = &outcomes[1] else { panic!("{outcomes:?}") };
        assert_eq!(message, "the card could not render: it is on fire");
        let LeaseOutcome::Failed { message } = &outcomes[2] else { panic!("{outcomes:?}") };
        assert_eq!(message, "the renderer panicked: no good at 64");
    }
    agent.stop().unwrap();
}

#[test]
fn a_full_server_makes_the_worker_release_and_back_off() {
    let server = FakeServer::start(30_000);
    let mut agent = Agent::start(&server, FakeRenderer);
    let (id, _) = add_job(&server, 32, 32, "");
    for whole_frame in [true, false] {
        server.change(|farm| farm.put_refusals = [StatusCode::INSUFFICIENT_STORAGE].into());
        let leases = server.change(|farm| farm.give(id, &cut(32, 32, 32, 32), whole_frame));
        assert!(matches!(server.outcomes(&leases)[..], [LeaseOutcome::Released]));
        let rests = server.until("the worker syncs again", |farm| {
            let place = farm.syncs.iter().rposition(|sync| !sync.reports.is_empty())?;
            Some(!farm.syncs[place].wants_work)
        });
        assert!(rests);
        let leases = server.change(|farm| farm.give(id, &cut(32, 32, 32, 32), whole_frame));
        assert!(!matches!(server.outcomes(&leases)[..], [LeaseOutcome::Released]));
    }
    agent.stop().unwrap();
}

#[test]
fn an_invalid_job_fails_and_a_deleted_job_is_released() {
    let server = FakeServer::start(30_000);
    let mut agent = Agent::start(&server, FakeRenderer);
    let broken = server.change(|farm| farm.add_job("{".to_owned()));
    let leases = server.change(|farm| farm.give(broken, &cut(64, 32, 32, 32), true));
    assert!(matches!(server.outcomes(&leases)[..], [LeaseOutcome::Failed { .. }, LeaseOutcome::Failed { .. }]));
    let leases = server.change(|farm| farm.give(JobId::new(), &cut(32, 32, 32, 32), true));
    assert!(matches!(server.outcomes(&leases)[..], [LeaseOutcome::Released]));
    agent.stop().unwrap();
}
