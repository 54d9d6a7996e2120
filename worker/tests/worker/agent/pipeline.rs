//! Concurrency in a worker: several tiles on the device, several pictures being delivered, and a device that is
//! lost.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use proto::worker_protocol::LeaseOutcome;
use proto::{JobId, LeaseId, Rect};
use worker::agent::AgentError;
use worker::{CancelFlag, RenderError, Renderer, TilePixels, TileRequest};

use super::{Agent, Happening, add_job, gated, until_cancelled};
use crate::fake_renderer::{FakeRenderer, cut};
use crate::fake_server::FakeServer;

const TILE: Rect = Rect { x: 0, y: 0, width: 32, height: 32 };
const BATCH: usize = 4;
const ENCODERS: usize = 4;

/// Runs a function before it renders tiles together, or instead.
struct Together<F>(F);

impl<F> Renderer for Together<F>
where
    F: Fn(&[TileRequest<'_>], &CancelFlag) -> Result<(), RenderError> + Send + Sync,
{
    fn device(&self) -> String {
        "cuda:1".to_owned()
    }

    fn render(&self, _: &TileRequest<'_>, _: &CancelFlag, _: &(dyn Fn(u64) + Sync)) -> Result<TilePixels, RenderError> {
        panic!("tiles must be rendered together")
    }

    fn render_tiles(
        &self,
        runs: &[TileRequest<'_>],
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<TilePixels>, RenderError> {
        (self.0)(runs, cancel)?;
        runs.iter().map(|run| FakeRenderer.render(run, &CancelFlag::new(), progress)).collect()
    }

    fn preferred_tiles(&self) -> usize {
        BATCH
    }

    fn encoder_threads(&self) -> usize {
        ENCODERS
    }

    fn max_nodes(&self) -> Option<u32> {
        Some(500)
    }
}

/// Fails like a lost card, from the first tile with x ≥ 32 on.
#[derive(Default)]
struct Failing {
    is_lost: AtomicBool,
}

impl Renderer for Failing {
    fn device(&self) -> String {
        "cuda:2".to_owned()
    }

    fn render(
        &self,
        run: &TileRequest<'_>,
        _: &CancelFlag,
        more: &(dyn Fn(u64) + Sync),
    ) -> Result<TilePixels, RenderError> {
        if run.rect.x < 32 {
            return FakeRenderer.render(run, &CancelFlag::new(), more);
        }
        self.is_lost.store(true, Ordering::Relaxed);
        Err(RenderError::Device { device: self.device(), reason: "error 79".to_owned() })
    }

    fn lost_reason(&self) -> Option<String> {
        self.is_lost.load(Ordering::Relaxed).then(|| "it fell off the bus".to_owned())
    }
}

fn give(server: &FakeServer, id: JobId) -> Vec<LeaseId> {
    server.change(|farm| farm.give(id, &[TILE], true))
}

fn is_picture(outcome: &LeaseOutcome) -> bool {
    matches!(outcome, LeaseOutcome::Picture { .. })
}

#[test]
fn a_revoked_tile_does_not_stop_tiles_rendered_with_it() {
    let server = FakeServer::start(30_000);
    let (begun, go, counts) = (Happening::default(), Happening::default(), Arc::new(Mutex::new(Vec::new())));
    let (begins, goes, seen) = (begun.clone(), go.clone(), counts.clone());
    let mut agent = Agent::start(
        &server,
        Together(move |runs: &[TileRequest<'_>], cancel: &CancelFlag| {
            seen.lock().unwrap().push(runs.len());
            begins.happen();
            goes.wait();
            assert!(!cancel.is_cancelled(), "a tile of this chunk is still leased");
            Ok(())
        }),
    );
    let (id, _) = add_job(&server, 96, 96, "");
    let mut leases = server.change(|farm| farm.give(id, &cut(96, 96, 32, 32), false));
    begun.wait();
    server.change(|farm| {
        farm.live.remove(&leases[1]);
        farm.live.remove(&leases[4]);
    });
    server.until("the worker knows the revoked leases", |farm| {
        farm.syncs.last().is_some_and(|sync| sync.held_leases.len() == 7).then_some(())
    });
    go.happen();
    leases.remove(4);
    leases.remove(1);
    let outcomes = server.outcomes(&leases);
    assert!(outcomes.iter().all(|outcome| matches!(outcome, LeaseOutcome::Blob { .. })), "{outcomes:?}");
    assert_eq!(*counts.lock().unwrap(), [4, 3, 1], "nine tiles by fours, one of the second chunk lost before it began");
    agent.stop().unwrap();
}

#[test]
fn tiles_without_live_leases_are_cancelled_together() {
    let server = FakeServer::start(30_000);
    let hangs = |runs: &[TileRequest<'_>], cancel: &CancelFlag| {
        if runs.len() > 1 { Err(until_cancelled(cancel)) } else { Ok(()) }
    };
    let mut agent = Agent::start(&server, Together(hangs));
    let ((id, _), (small, _)) = (add_job(&server, 96, 32, ""), add_job(&server, 32, 32, ""));
    for whole_frame in [false, true] {
        let leases = server.change(|farm| farm.give(id, &cut(96, 32, 32, 32), whole_frame));
        server.until("the tiles are held", |farm| {
            farm.syncs.last().is_some_and(|sync| sync.held_leases.len() == leases.len()).then_some(())
        });
        server.change(|farm| leases.iter().for_each(|lease| _ = farm.live.remove(lease)));
        let next = give(&server, small);
        assert!(server.outcomes(&next).iter().all(is_picture));
    }
    agent.stop().unwrap();
}

#[test]
fn only_the_failing_tile_of_a_batch_is_reported() {
    let server = FakeServer::start(30_000);
    let fails = |runs: &[TileRequest<'_>], _: &CancelFlag| {
        let is_bad = runs.iter().any(|run| run.rect.x == 32);
        let error = || RenderError::Device { device: "the card".to_owned(), reason: "no".to_owned() };
        if is_bad { Err(error()) } else { Ok(()) }
    };
    let mut agent = Agent::start(&server, Together(fails));
    let (id, _) = add_job(&server, 96, 32, "");
    for whole_frame in [false, true] {
        let leases = server.change(|farm| farm.give(id, &cut(96, 32, 32, 32), whole_frame));
        let outcomes = server.outcomes(&leases);
        let [LeaseOutcome::Blob { .. }, LeaseOutcome::Failed { message }, LeaseOutcome::Blob { .. }] = &outcomes[..]
        else {
            panic!("{outcomes:?}")
        };
        assert_eq!(message, "the card could not render: no");
    }
    agent.stop().unwrap();
}

#[test]
fn a_worker_with_a_lost_device_releases_everything_and_exits() {
    for whole_frame in [false, true] {
        let server = FakeServer::start(30_000);
        server.change(|farm| farm.hold_puts = true);
        let mut agent = Agent::start(&server, Failing::default());
        let ((id, _), (small, _)) = (add_job(&server, 96, 32, ""), add_job(&server, 32, 32, ""));
        let delivered = give(&server, small);
        server.until("a picture is being delivered", |farm| (farm.putting == 1).then_some(()));
        let leases = server.change(|farm| farm.give(id, &cut(96, 32, 32, 32), whole_frame));
        let error = agent.ended().unwrap_err();
        assert!(matches!(&error, AgentError::DeviceLost { reason } if reason == "it fell off the bus"), "{error:?}");
        let outcomes = server.outcomes(&[delivered, leases].concat());
        // The first tile of the second batch may have been delivered before the second tile was tried.
        let is_harmless = |outcome| matches!(outcome, &(LeaseOutcome::Released | LeaseOutcome::Blob { .. }));
        assert!(outcomes.iter().all(is_harmless), "{outcomes:?}");
        assert!(matches!(outcomes[2..], [LeaseOutcome::Released, LeaseOutcome::Released]), "{outcomes:?}");
    }
}

#[test]
fn one_short_batch_is_requested_ahead() {
    let server = FakeServer::start(30_000);
    let (begun, go, count) = (Happening::default(), Happening::default(), Arc::new(Mutex::new(0)));
    let (begins, goes) = (begun.clone(), go.clone());
    let mut agent = Agent::start(
        &server,
        Together(move |_: &[TileRequest<'_>], _: &CancelFlag| {
            let mut count = count.lock().unwrap();
            *count += 1;
            if *count > 1 {
                begins.happen();
                goes.wait();
            }
            Ok(())
        }),
    );
    let (id, _) = add_job(&server, 32, 32, "");
    assert!(server.outcomes(&give(&server, id)).iter().all(is_picture));
    let leases = [give(&server, id), give(&server, id), give(&server, id)].concat();
    begun.wait();
    server.until("the worker has two batches and requests no third", |farm| {
        let sync = farm.syncs.last()?;
        (sync.held_leases.len() == 2 && !sync.wants_work).then_some(())
    });
    assert_eq!(server.change(|farm| farm.queue.len()), 1);
    go.happen();
    assert!(server.outcomes(&leases).iter().all(is_picture));
    agent.stop().unwrap();
}

#[test]
fn nothing_is_requested_ahead_before_a_batch_was_short() {
    let server = FakeServer::start(30_000);
    let (begun, go) = (Happening::default(), Happening::default());
    let mut agent = Agent::start(&server, gated(&begun, &go));
    let (id, _) = add_job(&server, 32, 32, "");
    let leases = [give(&server, id), give(&server, id)].concat();
    begun.wait();
    server.until("the worker renews its lease and requests no more", |farm| {
        let sync = farm.syncs.last()?;
        (sync.held_leases.len() == 1 && !sync.wants_work).then_some(())
    });
    assert_eq!(server.change(|farm| farm.queue.len()), 1);
    go.happen();
    assert!(server.outcomes(&leases).iter().all(is_picture));
    agent.stop().unwrap();
}

#[test]
fn pictures_are_delivered_while_others_render() {
    let server = FakeServer::start(30_000);
    server.change(|farm| farm.hold_puts = true);
    let mut agent = Agent::start(&server, Together(|_: &[TileRequest<'_>], _: &CancelFlag| Ok(())));
    let (id, _) = add_job(&server, 32, 32, "");
    let leases: Vec<LeaseId> = (0..20).flat_map(|_| give(&server, id)).collect();
    server.until("one picture per encoder is being delivered, and no more work is requested", |farm| {
        let sync = farm.syncs.last()?;
        (farm.putting >= ENCODERS && sync.held_leases.len() == farm.putting && !sync.wants_work).then_some(())
    });
    let (putting, waiting) = server.change(|farm| (farm.putting, farm.queue.len()));
    assert!(
        putting <= ENCODERS + ENCODERS / 2 + 1 && putting + waiting == leases.len(),
        "{putting} are being delivered, {waiting} wait"
    );
    server.change(|farm| farm.hold_puts = false);
    assert!(server.outcomes(&leases).iter().all(is_picture));
    agent.stop().unwrap();
}

#[test]
fn a_renderers_limits_are_reported_to_the_server() {
    let server = FakeServer::start(30_000);
    let mut agent = Agent::start(&server, Together(|_: &[TileRequest<'_>], _: &CancelFlag| Ok(())));
    let hello = server.until("the worker registers", |farm| farm.hellos.pop());
    assert_eq!(hello.max_nodes, Some(500));
    agent.stop().unwrap();
}

/// Frees its device before it has the pixels, which it returns after a function.
struct Overlapping<F>(F);

impl<F> Renderer for Overlapping<F>
where
    F: Fn(&[TileRequest<'_>], &CancelFlag) -> Result<(), RenderError> + Send + Sync,
{
    fn device(&self) -> String {
        "cuda:3".to_owned()
    }

    fn render(&self, _: &TileRequest<'_>, _: &CancelFlag, _: &(dyn Fn(u64) + Sync)) -> Result<TilePixels, RenderError> {
        panic!("tiles must be rendered together")
    }

    fn render_overlapped(
        &self,
        runs: &[TileRequest<'_>],
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
        on_device_free: &mut dyn FnMut(),
    ) -> Result<Vec<TilePixels>, RenderError> {
        on_device_free();
        (self.0)(runs, cancel)?;
        runs.iter().map(|run| FakeRenderer.render(run, &CancelFlag::new(), progress)).collect()
    }

    fn overlapping(&self) -> usize {
        3
    }

    fn preferred_tiles(&self) -> usize {
        BATCH
    }

    fn encoder_threads(&self) -> usize {
        ENCODERS
    }
}

#[test]
fn the_next_batch_renders_while_pixels_are_fetched() {
    let server = FakeServer::start(30_000);
    let (go, count) = (Happening::default(), Arc::new(Mutex::new(0)));
    let (goes, counts) = (go.clone(), count.clone());
    let mut agent = Agent::start(
        &server,
        Overlapping(move |_: &[TileRequest<'_>], _: &CancelFlag| {
            *counts.lock().unwrap() += 1;
            goes.wait();
            Ok(())
        }),
    );
    let (id, _) = add_job(&server, 32, 32, "");
    let leases: Vec<LeaseId> = (0..8).flat_map(|_| give(&server, id)).collect();
    server.until("the worker has as many batches in stages as it may, and requests no more", |farm| {
        let sync = farm.syncs.last()?;
        (*count.lock().unwrap() == 3 && sync.held_leases.len() > 3 && !sync.wants_work).then_some(())
    });
    go.happen();
    assert!(server.outcomes(&leases).iter().all(is_picture));
    agent.stop().unwrap();
}

#[test]
fn a_batch_whose_pixels_cannot_be_fetched_is_rendered_tile_by_tile() {
    let server = FakeServer::start(30_000);
    let fails = |runs: &[TileRequest<'_>], _: &CancelFlag| {
        let is_bad = runs.len() > 1 || runs[0].rect.x == 32;
        let error = || RenderError::Device { device: "the card".to_owned(), reason: "no".to_owned() };
        if is_bad { Err(error()) } else { Ok(()) }
    };
    let mut agent = Agent::start(&server, Overlapping(fails));
    let ((id, _), (small, _)) = (add_job(&server, 96, 32, ""), add_job(&server, 32, 32, ""));
    for whole_frame in [false, true] {
        let leases = server.change(|farm| farm.give(id, &cut(96, 32, 32, 32), whole_frame));
        let next: Vec<LeaseId> = (0..4).flat_map(|_| give(&server, small)).collect();
        let outcomes = server.outcomes(&leases);
        let [LeaseOutcome::Blob { .. }, LeaseOutcome::Failed { message }, LeaseOutcome::Blob { .. }] = &outcomes[..]
        else {
            panic!("{outcomes:?}")
        };
        assert_eq!(message, "the card could not render: no");
        assert!(server.outcomes(&next).iter().all(is_picture));
    }
    agent.stop().unwrap();
}

#[test]
fn a_revoked_batch_is_cancelled_while_its_pixels_are_fetched() {
    let server = FakeServer::start(30_000);
    let hangs = |runs: &[TileRequest<'_>], cancel: &CancelFlag| {
        if runs.len() > 1 { Err(until_cancelled(cancel)) } else { Ok(()) }
    };
    let mut agent = Agent::start(&server, Overlapping(hangs));
    let ((id, _), (small, _)) = (add_job(&server, 96, 32, ""), add_job(&server, 32, 32, ""));
    let leases = server.change(|farm| farm.give(id, &cut(96, 32, 32, 32), true));
    let next = give(&server, small);
    assert!(server.outcomes(&next).iter().all(is_picture), "it does not wait for the other's pixels");
    server.change(|farm| leases.iter().for_each(|lease| _ = farm.live.remove(lease)));
    server.until("the worker has dropped them", |farm| {
        farm.syncs.last().is_some_and(|sync| sync.held_leases.is_empty()).then_some(())
    });
    agent.stop().unwrap();
}

#[test]
fn several_short_batches_are_requested_in_one_call() {
    let server = FakeServer::start(30_000);
    server.change(|farm| farm.max_batches = 4);
    let (begun, go, count) = (Happening::default(), Happening::default(), Arc::new(Mutex::new(0)));
    let (begins, goes) = (begun.clone(), go.clone());
    let mut agent = Agent::start(
        &server,
        Together(move |_: &[TileRequest<'_>], _: &CancelFlag| {
            let mut count = count.lock().unwrap();
            *count += 1;
            if *count > 1 {
                begins.happen();
                goes.wait();
            }
            Ok(())
        }),
    );
    let (id, _) = add_job(&server, 32, 32, "");
    assert!(server.outcomes(&give(&server, id)).iter().all(is_picture));
    let leases = server.change(|farm| (0..20).flat_map(|_| farm.give(id, &[TILE], true)).collect::<Vec<_>>());
    begun.wait();
    server.until("the worker has some batches ahead and requests no more", |farm| {
        let sync = farm.syncs.last()?;
        (sync.held_leases.len() > 2 && !sync.wants_work).then_some(())
    });
    let (most, left) = server.change(|farm| (farm.syncs.iter().map(|sync| sync.max_batches).max(), farm.queue.len()));
    assert!(most == Some(4) && left > 0, "{most:?} at a time, {left} left");
    go.happen();
    assert!(server.outcomes(&leases).iter().all(is_picture));
    agent.stop().unwrap();
}
