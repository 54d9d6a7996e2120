//! Leases: renewed while work continues, dropped when they are revoked.

use std::time::Duration;

use proto::Rect;
use proto::worker_protocol::LeaseOutcome;
use worker::{CancelFlag, TileRequest};

use super::{Acting, Agent, Happening, add_job, gated, until_cancelled};
use crate::fake_renderer::{FakeRenderer, cut};
use crate::fake_server::FakeServer;

const TILE: Rect = Rect { x: 0, y: 0, width: 32, height: 32 };

/// Blocks in tiles that do not start at the left edge.
fn hangs_beside_the_edge(run: &TileRequest<'_>, cancel: &CancelFlag) -> Result<(), worker::RenderError> {
    if run.rect.x == 0 { Ok(()) } else { Err(until_cancelled(cancel)) }
}

#[test]
fn leases_are_renewed_while_a_tile_renders() {
    let server = FakeServer::start(600);
    let (begun, go) = (Happening::default(), Happening::default());
    let mut agent = Agent::start(&server, gated(&begun, &go));
    let (id, _) = add_job(&server, 64, 32, "");
    let leases = server.change(|farm| farm.give(id, &cut(64, 32, 32, 32), false));
    server.until("both leases were renewed twenty times", |farm| {
        let renewals = farm.syncs.iter().filter(|sync| leases.iter().all(|lease| sync.held_leases.contains(lease)));
        (renewals.count() >= 20).then_some(())
    });
    go.happen();
    assert!(matches!(server.outcomes(&leases)[..], [LeaseOutcome::Blob { .. }, LeaseOutcome::Blob { .. }]));
    agent.stop().unwrap();
}

#[test]
fn a_revoked_lease_cancels_only_its_own_render() {
    let server = FakeServer::start(30_000);
    let mut agent = Agent::start(&server, Acting(hangs_beside_the_edge));
    let (id, _) = add_job(&server, 64, 64, "");
    for whole_frame in [false, true] {
        let leases = server.change(|farm| farm.give(id, &cut(64, 64, 32, 64), whole_frame));
        server.until("the tiles are leased and a heartbeat waits", |farm| {
            let held = farm.syncs.last().is_some_and(|sync| sync.held_leases.contains(&leases[1]));
            held.then_some(())
        });
        server.change(|farm| farm.live.remove(&leases[1]));
        assert!(matches!(server.outcomes(&leases[..1])[..], [LeaseOutcome::Blob { .. }]));
        let next = server.change(|farm| farm.give(id, &[TILE], false));
        assert!(matches!(server.outcomes(&next)[..], [LeaseOutcome::Blob { .. }]));
        let silent = server
            .change(|farm| farm.syncs.iter().flat_map(|sync| &sync.reports).all(|report| report.lease != leases[1]));
        assert!(silent, "nothing is reported for a revoked lease");
    }
    agent.stop().unwrap();
}

#[test]
fn a_worker_without_a_connection_stops_rendering() {
    let mut server = FakeServer::start(900);
    let (begun, cancelled) = (Happening::default(), Happening::default());
    let (begins, ends) = (begun.clone(), cancelled.clone());
    let renderer = Acting(move |_: &TileRequest<'_>, cancel: &CancelFlag| {
        begins.happen();
        let error = until_cancelled(cancel);
        ends.happen();
        Err(error)
    });
    let mut agent = Agent::start(&server, renderer);
    let (id, _) = add_job(&server, 32, 32, "");
    let leases = server.change(|farm| farm.give(id, &[TILE], false));
    begun.wait();
    server.kill();
    cancelled.wait();
    server.up();
    assert!(matches!(server.outcomes(&leases)[..], [LeaseOutcome::Released]));
    agent.stop().unwrap();
}

#[test]
fn no_result_is_lost_when_the_server_restarts() {
    for whole_frame in [false, true] {
        let mut server = FakeServer::start(30_000);
        let (begun, go) = (Happening::default(), Happening::default());
        let mut agent = Agent::start(&server, gated(&begun, &go));
        let (id, _) = add_job(&server, 64, 32, "");
        let leases = server.change(|farm| farm.give(id, &cut(64, 32, 32, 32), whole_frame));
        begun.wait();
        server.kill();
        go.happen();
        server.up();
        let outcomes = server.outcomes(&leases);
        let stored = |outcome| matches!(outcome, &(LeaseOutcome::Blob { .. } | LeaseOutcome::Picture { .. }));
        assert!(outcomes.iter().all(stored), "{outcomes:?}");
        assert_eq!(server.change(|farm| farm.hellos.len()), 1);
        agent.stop().unwrap();
    }
}

#[test]
fn a_drained_worker_finishes_its_leases_and_exits() {
    let server = FakeServer::start(30_000);
    let (begun, go) = (Happening::default(), Happening::default());
    let mut agent = Agent::start(&server, gated(&begun, &go));
    let (id, _) = add_job(&server, 64, 32, "");
    let leases = server.change(|farm| farm.give(id, &cut(64, 32, 32, 32), false));
    begun.wait();
    server.change(|farm| farm.drain = true);
    go.happen();
    agent.ended().unwrap();
    assert!(matches!(server.outcomes(&leases)[..], [LeaseOutcome::Blob { .. }, LeaseOutcome::Blob { .. }]));
}

#[test]
fn a_worker_releases_unfinished_leases_after_its_grace_period() {
    let server = FakeServer::start(30_000);
    let mut agent = Agent::with_grace(&server, Acting(hangs_beside_the_edge), Duration::ZERO);
    let (id, _) = add_job(&server, 96, 32, "");
    let leases = server.change(|farm| farm.give(id, &cut(96, 32, 32, 32), false));
    assert!(matches!(server.outcomes(&leases[..1])[..], [LeaseOutcome::Blob { .. }]));
    agent.stop().unwrap();
    let outcomes = server.outcomes(&leases);
    assert!(matches!(outcomes[1..], [LeaseOutcome::Released, LeaseOutcome::Released]), "{outcomes:?}");
}

#[test]
fn a_worker_finishes_leases_within_its_grace_period() {
    let server = FakeServer::start(30_000);
    let (begun, go) = (Happening::default(), Happening::default());
    let mut agent = Agent::start(&server, gated(&begun, &go));
    let (id, _) = add_job(&server, 32, 32, "");
    let leases = server.change(|farm| farm.give(id, &[TILE], true));
    begun.wait();
    agent.shutdown.cancel();
    go.happen();
    agent.ended().unwrap();
    assert!(matches!(server.outcomes(&leases)[..], [LeaseOutcome::Picture { .. }]));
}

#[test]
fn an_idle_worker_exits_at_once() {
    let server = FakeServer::start(30_000);
    let mut agent = Agent::start(&server, FakeRenderer);
    server.until("the worker waits for work", |farm| (farm.waiting > 0).then_some(()));
    agent.stop().unwrap();
}
