//! Client requests for previews, links and retention.

use std::io::Write;

use reqwest::Method;

use super::{Client, ClientError};
use crate::JobId;
use crate::frame::ForgottenPicture;
use crate::link::{LinkRequest, LinkView};
use crate::retention::GcReport;

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

    /// Forgets a picture everywhere, by the BLAKE3 of its bytes in hex.
    pub async fn forget_picture(&self, hash: &str) -> Result<ForgottenPicture, ClientError> {
        self.json(self.request(Method::DELETE, &format!("/v1/pictures/{hash}"))).await
    }

    /// Deletes the jobs past their retention, or lists them.
    pub async fn collect_garbage(&self, dry_run: bool) -> Result<GcReport, ClientError> {
        self.json(self.request(Method::POST, "/v1/gc").query(&[("dry_run", dry_run)])).await
    }
}
