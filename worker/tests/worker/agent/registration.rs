//! Registration of a worker with its server.

use axum::http::StatusCode;
use proto::Rect;
use proto::worker_protocol::LeaseOutcome;
use tokio_util::sync::CancellationToken;
use worker::agent::{AgentConfig, AgentError, run};

use super::{Agent, add_job};
use crate::fake_renderer::FakeRenderer;
use crate::fake_server::FakeServer;

#[test]
fn a_worker_waits_for_a_server_that_starts_later() {
    let mut server = FakeServer::down(30_000);
    let mut agent = Agent::start(&server, FakeRenderer);
    server.up();
    let hello = server.until("the worker registers", |farm| farm.hellos.pop());
    assert_eq!((hello.name.as_str(), hello.device.as_str()), ("tester", "cuda:7"));
    assert_eq!(hello.picture_version, scene::PICTURE_VERSION);
    assert_eq!(hello.process, std::process::id());
    agent.stop().unwrap();
}

#[test]
fn a_rejected_worker_exits_with_the_servers_message() {
    let server = FakeServer::start(30_000);
    let problem =
        r#"{"type": "/docs#x", "title": "x", "status": 409, "code": "x", "detail": "the picture version is 2"}"#;
    for (status, body, said) in [
        (StatusCode::CONFLICT, problem, "the picture version is 2"),
        (StatusCode::UNAUTHORIZED, "", "401 Unauthorized"),
    ] {
        server.change(|farm| farm.refusal = Some((status, body.to_owned())));
        let error = Agent::start(&server, FakeRenderer).ended().unwrap_err();
        let expected = format!("the server {} rejected this worker: {said}", server.url());
        assert_eq!(error.to_string(), expected);
    }
}

#[test]
fn a_worker_unknown_to_the_server_registers_again() {
    let server = FakeServer::start(30_000);
    let mut agent = Agent::start(&server, FakeRenderer);
    server.until("the worker waits for work", |farm| (farm.waiting > 0).then_some(()));
    let (id, _) = add_job(&server, 32, 32, "");
    let leases = server.change(|farm| {
        farm.workers.clear();
        farm.give(id, &[Rect::full(32, 32)], false)
    });
    server.until("it registers again", |farm| (farm.hellos.len() == 2).then_some(()));
    let next = server.change(|farm| farm.give(id, &[Rect::full(32, 32)], false));
    assert!(matches!(server.outcomes(&next)[..], [LeaseOutcome::Blob { .. }]));
    drop(leases);
    agent.stop().unwrap();
}

#[tokio::test]
async fn an_invalid_address_is_rejected() {
    for server in ["", "farm", "ftp://farm", "http://", "file:///tmp"] {
        let ended = run(
            AgentConfig::new(vec![server.to_owned()], "x"),
            std::sync::Arc::new(FakeRenderer),
            CancellationToken::default(),
        )
        .await;
        assert!(matches!(ended, Err(AgentError::Access(_))), "{server}");
    }
}
