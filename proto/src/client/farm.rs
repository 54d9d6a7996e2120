//! Client requests for workers and for the history of the farm and of tiles.

use reqwest::Method;

use super::{Client, ClientError};
use crate::history::HistoryView;
use crate::pool::{WorkerList, WorkerView};
use crate::tile_history::TilePage;
use crate::{JobId, WorkerId};

/// Change of a worker by an administrator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorkerChange {
    /// It gets no more work, and exits when it has finished what it holds.
    Drain,
    /// It gets no work until it is released.
    Quarantine,
    /// It gets work again.
    Release,
}

impl WorkerChange {
    fn name(self) -> &'static str {
        match self {
            Self::Drain => "drain",
            Self::Quarantine => "quarantine",
            Self::Release => "release",
        }
    }
}

impl Client {
    /// Lists every worker that is not gone.
    pub async fn workers(&self) -> Result<WorkerList, ClientError> {
        self.json(self.request(Method::GET, "/v1/workers")).await
    }

    /// Changes a worker.
    pub async fn change_worker(&self, id: WorkerId, change: WorkerChange) -> Result<WorkerView, ClientError> {
        self.json(self.request(Method::POST, &format!("/v1/workers/{id}/{}", change.name()))).await
    }

    /// Throughput of the last seconds, in at most this number of steps.
    pub async fn history(&self, seconds: u32, points: u32) -> Result<HistoryView, ClientError> {
        let request = self.request(Method::GET, "/v1/history");
        self.json(request.query(&[("seconds", seconds), ("points", points)])).await
    }

    /// A page of a job's tiles, or of one frame's; `cursor` is the `next_cursor` of the page before.
    pub async fn tiles(
        &self,
        id: JobId,
        frame: Option<u32>,
        limit: u32,
        cursor: Option<&str>,
    ) -> Result<TilePage, ClientError> {
        let request = self.request(Method::GET, &format!("/v1/jobs/{id}/tiles")).query(&[("limit", limit)]);
        let request = request.query(&[("frame", frame)]).query(&[("cursor", cursor)]);
        self.json(request).await
    }
}
