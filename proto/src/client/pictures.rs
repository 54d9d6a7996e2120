//! Client requests for previews, links and retention.

use std::io::Write;

use reqwest::Method;

use super::{Client, ClientError};
use crate::JobId;
use crate::frame::ForgottenPicture;
use crate::job::JobPage;
use crate::link::{LinkRequest, LinkView};
use crate::retention::GcReport;
use crate::verify::Verification;

impl Client {
    /// Writes a PNG of the finished part of a frame to `out`; returns its size in bytes.
    pub async fn preview(
        &self,
        id: JobId,
        frame: u32,
        width_px: Option<u32>,
        out: &mut (dyn Write + Send),
    ) -> Result<u64, ClientError> {
        let mut request = self.request(Method::GET, &format!("/v1/jobs/{id}/frames/{frame}/preview"));
        if let Some(width_px) = width_px {
            request = request.query(&[("width", width_px)]);
        }
        self.download(request, out).await
    }

    /// Creates a signed link to a frame's picture.
    pub async fn link(&self, id: JobId, frame: u32, link: &LinkRequest) -> Result<LinkView, ClientError> {
        self.json(self.request(Method::POST, &format!("/v1/jobs/{id}/frames/{frame}/link")).json(link)).await
    }

    /// Has the server render tiles of a frame's stored picture again; with 0 tiles it only says who made it.
    pub async fn verify(&self, id: JobId, frame: u32, tiles: u32) -> Result<Verification, ClientError> {
        let request = self.request(Method::POST, &format!("/v1/jobs/{id}/frames/{frame}/verify"));
        self.json(request.query(&[("tiles", tiles)])).await
    }

    /// Jobs with a picture of this hash (`picture`), or of this scene (`scene`), newest first.
    pub async fn jobs_of_picture(&self, by: &str, hash: &str, limit: u32) -> Result<JobPage, ClientError> {
        self.json(self.request(Method::GET, "/v1/jobs").query(&[(by, hash), ("limit", &limit.to_string())])).await
    }

    /// Forgets a picture everywhere, by the BLAKE3 of its bytes in hex.
    pub async fn forget_picture(&self, hash: &str) -> Result<ForgottenPicture, ClientError> {
        self.json(self.request(Method::DELETE, &format!("/v1/pictures/{hash}"))).await
    }

    /// Deletes the jobs past their retention, or lists them.
    pub async fn collect_garbage(&self, dry_run: bool) -> Result<GcReport, ClientError> {
        self.json(self.request(Method::POST, "/v1/gc").query(&[("dry_run", dry_run)])).await
    }
}
