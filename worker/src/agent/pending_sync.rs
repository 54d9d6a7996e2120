//! A call of a session that the server has not answered yet.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use proto::worker_protocol::{SyncRequest, SyncResponse};
use tokio::time::Instant;

use super::server_client::{ServerClient, ServerError};

/// An open call.
pub(super) struct PendingSync {
    /// The sent request.
    pub(super) request: SyncRequest,
    /// When it was sent.
    pub(super) start: Instant,
    answer: Pin<Box<dyn Future<Output = Result<SyncResponse, ServerError>> + Send>>,
}

impl PendingSync {
    /// Calls the server.
    pub(super) fn new(link: &Arc<ServerClient>, request: SyncRequest, timeout: Duration) -> Self {
        let (link, sent) = (link.clone(), request.clone());
        Self { request, start: Instant::now(), answer: Box::pin(async move { link.sync(&sent, timeout).await }) }
    }

    /// Whether the call may be dropped: it reports nothing, and its response cannot grant anything.
    pub(super) fn is_heartbeat(&self) -> bool {
        self.request.reports.is_empty() && !self.request.wants_work
    }

    /// Waits for a call's response; never returns if there is no call.
    pub(super) async fn response_of(call: &mut Option<Self>) -> (Self, Result<SyncResponse, ServerError>) {
        match call {
            Some(open) => {
                let answer = open.answer.as_mut().await;
                (call.take().expect("it is open"), answer)
            }
            None => std::future::pending().await,
        }
    }
}
