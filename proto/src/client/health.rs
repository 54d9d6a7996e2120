//! Health of a server.

use reqwest::Method;
use serde::Deserialize;

use super::{Client, ClientError};

/// Response of `GET /readyz`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Readiness {
    /// `ready`, or `degraded` without a worker.
    pub status: String,
}

impl Client {
    /// Whether database and store can be used; if not, the problem is the error.
    pub async fn ready(&self) -> Result<Readiness, ClientError> {
        self.json(self.request(Method::GET, "/readyz")).await
    }

    /// Every metric, as text.
    pub async fn metrics(&self) -> Result<String, ClientError> {
        let response = self.send(self.request(Method::GET, "/metrics")).await?;
        response.text().await.map_err(|source| self.connection_lost(source))
    }
}
