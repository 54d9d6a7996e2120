//! Follower of the whole farm: a greeting, the farm's numbers, and then what it may see of each batch.

use std::sync::Arc;
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use proto::event::HelloEvent;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio_util::sync::CancellationToken;

use super::{Batch, FarmEvents, VisibleEvent, encode_event};
use crate::clock::rfc3339;
use crate::db::DatabaseError;

/// After this time without events a comment is sent, so that proxies do not close the connection.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(15);
/// The comment.
const KEEP_ALIVE_COMMENT: &[u8] = b":\n\n";
/// Size above which events are sent in several pieces, so that a follower that does not read keeps few in memory.
const MAX_PIECE_BYTES: usize = 16 << 10;

/// Follower of the whole farm.
#[derive(Debug)]
pub(crate) struct FarmSubscriber {
    batches: Receiver<Arc<Batch>>,
    ending: CancellationToken,
    /// Name whose jobs are the only ones that it sees; `None` if it sees all, and the farm's numbers.
    submitter: Option<String>,
    first: Option<Bytes>,
    /// Batch that is being sent, and the number of its events that were looked at.
    current: Option<(Arc<Batch>, usize)>,
}

impl FarmSubscriber {
    /// Follows the farm from now on, or only the jobs of one name.
    pub(crate) async fn start(
        events: &FarmEvents,
        submitter: Option<&str>,
        ending: CancellationToken,
    ) -> Result<Self, DatabaseError> {
        let (counts, batches) = events.receive().await?;
        let hello = HelloEvent { server_time: rfc3339(events.queue.wall_ms()) };
        let mut first = BytesMut::from(&*encode_event("hello", &hello));
        if submitter.is_none() {
            first.extend_from_slice(&encode_event("farm", &counts));
        }
        let submitter = submitter.map(str::to_owned);
        Ok(Self { batches, ending, submitter, first: Some(first.freeze()), current: None })
    }

    /// The next bytes to send; `None` at the end.
    pub(crate) async fn next(&mut self) -> Option<Bytes> {
        if let Some(first) = self.first.take() {
            return Some(first);
        }
        loop {
            if let Some(piece) = self.next_piece() {
                return Some(piece);
            }
            let received = tokio::select! {
                () = self.ending.cancelled() => return None,
                received = tokio::time::timeout(KEEP_ALIVE_INTERVAL, self.batches.recv()) => received,
            };
            match received {
                Err(_) => return Some(Bytes::from_static(KEEP_ALIVE_COMMENT)),
                Ok(Ok(batch)) => self.current = Some((batch, 0)),
                Ok(Err(RecvError::Lagged(_))) => {
                    // The views that it has missed are in its list; older views of jobs must not follow that.
                    self.batches = self.batches.resubscribe();
                    self.current = Some((Arc::new(Batch::Resync), 0));
                }
                Ok(Err(RecvError::Closed)) => return None,
            }
        }
    }

    /// The next events of the current batch that it may see.
    fn next_piece(&mut self) -> Option<Bytes> {
        let (batch, position) = self.current.take()?;
        let Batch::Events(events) = &*batch else {
            return Some(encode_event("resync", &serde_json::json!({})));
        };
        let mut piece = BytesMut::new();
        let mut next = position;
        while let Some(event) = events.get(next).filter(|_| piece.len() < MAX_PIECE_BYTES) {
            if self.may_see(event) {
                piece.extend_from_slice(&event.text);
            }
            next += 1;
        }
        if next < events.len() {
            self.current = Some((batch, next));
        }
        (!piece.is_empty()).then(|| piece.freeze())
    }

    fn may_see(&self, event: &VisibleEvent) -> bool {
        self.submitter.is_none() || self.submitter == event.submitter
    }
}
