//! Client requests for the health of a server.

use reqwest::Method;
use serde::Deserialize;

use super::{Client, ClientError};
use crate::alert::{AlertList, AlertView};

/// Response of `GET /readyz`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Readiness {
    /// `ready`, or `degraded` without a worker.
    pub status: String,
}

impl Client {
    /// Whether the database and the content store can be used; if not, the error is the problem.
    pub async fn ready(&self) -> Result<Readiness, ClientError> {
        self.json(self.request(Method::GET, "/readyz")).await
    }

    /// Conditions that need an operator.
    pub async fn alerts(&self) -> Result<Vec<AlertView>, ClientError> {
        let list: AlertList = self.json(self.request(Method::GET, "/v1/alerts")).await?;
        Ok(list.alerts)
    }

    /// Metrics in the `OpenMetrics` text format.
    pub async fn metrics(&self) -> Result<String, ClientError> {
        let response = self.send(self.request(Method::GET, "/metrics")).await?;
        response.text().await.map_err(|source| self.connection_lost(source))
    }
}
