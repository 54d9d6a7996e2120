//! Renders that take too long, and renders that do not stop.

use proto::worker_protocol::LeaseOutcome;
use worker::agent::AgentError;
use worker::{CancelFlag, TileRequest};

use super::{Acting, Agent, Happening, add_job, until_cancelled};
use crate::fake_renderer::cut;
use crate::fake_server::FakeServer;

/// Renderer that hangs in tiles that do not start at the left edge until `go`, and ignores its flag.
fn hanging(begun: &Happening, go: &Happening) -> impl worker::Renderer + use<> {
    let (begun, go) = (begun.clone(), go.clone());
    Acting(move |run: &TileRequest<'_>, _: &CancelFlag| {
        if run.rect.x > 0 {
            begun.happen();
            go.wait();
        }
        Ok(())
    })
}

/// Waits until the worker says that it is shutting down.
fn says_goodbye(server: &FakeServer) {
    server.until("the worker says that it is shutting down", |farm| {
        farm.syncs.iter().any(|sync| sync.shutting_down).then_some(())
    });
}

#[test]
fn a_tile_over_its_limit_is_stopped_and_reported() {
    let server = FakeServer::start(30_000);
    let late = |run: &TileRequest<'_>, cancel: &CancelFlag| {
        if run.rect.x == 0 { Ok(()) } else { Err(until_cancelled(cancel)) }
    };
    let mut agent = Agent::start(&server, Acting(late));
    let (id, _) = add_job(&server, 64, 32, "");
    let leases = server.change(|farm| {
        farm.tile_seconds = Some(1);
        farm.give(id, &cut(64, 32, 32, 32), false)
    });
    match &server.outcomes(&leases)[..] {
        [LeaseOutcome::Blob { .. }, LeaseOutcome::Failed { message }] => {
            for word in ["its limit of 1 s", "fewer samples", "smaller tiles", "--tile-seconds"] {
                assert!(message.contains(word), "{message}");
            }
        }
        other => panic!("{other:?}"),
    }
    agent.stop().unwrap();
}

#[test]
fn a_worker_whose_render_does_not_stop_hands_its_tiles_back_and_exits() {
    let server = FakeServer::start(30_000);
    let (begun, go) = (Happening::default(), Happening::default());
    let mut agent = Agent::start(&server, hanging(&begun, &go));
    let (id, _) = add_job(&server, 96, 32, "");
    let leases = server.change(|farm| farm.give(id, &cut(96, 32, 32, 32)[1..2], false));
    begun.wait();
    server.change(|farm| farm.live.remove(&leases[0]));
    says_goodbye(&server);
    go.happen();
    assert!(matches!(agent.ended(), Err(AgentError::Stuck { .. })));
}

#[test]
fn a_tile_that_hangs_over_its_limit_has_failed() {
    let server = FakeServer::start(30_000);
    let (begun, go) = (Happening::default(), Happening::default());
    let mut agent = Agent::start(&server, hanging(&begun, &go));
    let (id, _) = add_job(&server, 96, 32, "");
    let leases = server.change(|farm| {
        farm.tile_seconds = Some(1);
        farm.give(id, &cut(96, 32, 32, 32)[1..], false)
    });
    let outcomes = server.outcomes(&leases);
    assert!(matches!(outcomes[..], [LeaseOutcome::Failed { .. }, LeaseOutcome::Released]), "{outcomes:?}");
    says_goodbye(&server);
    go.happen();
    assert!(matches!(agent.ended(), Err(AgentError::Stuck { .. })));
}
