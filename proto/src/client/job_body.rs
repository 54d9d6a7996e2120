//! Body of a submission: the job file, compressed if it is large.

use std::io::Write;

use flate2::Compression;
use flate2::write::GzEncoder;
use reqwest::RequestBuilder;
use reqwest::header::{CONTENT_ENCODING, CONTENT_TYPE};

/// Size up to which a job file is sent as it is.
const MAX_PLAIN_BYTES: usize = 64 << 10;

/// Request with this job file as its body.
pub(super) fn attach(request: RequestBuilder, job: Vec<u8>) -> RequestBuilder {
    let request = request.header(CONTENT_TYPE, "application/json");
    if job.len() <= MAX_PLAIN_BYTES {
        return request.body(job);
    }
    request.header(CONTENT_ENCODING, "gzip").body(gzip(&job))
}

fn gzip(job: &[u8]) -> Vec<u8> {
    let mut writer = GzEncoder::new(Vec::new(), Compression::fast());
    writer.write_all(job).and_then(|()| writer.finish()).expect("a Vec takes all that is written")
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use flate2::read::GzDecoder;
    use reqwest::Method;

    use super::*;
    use crate::Client;

    /// Body of a submission of a file of this many bytes, and whether it is compressed.
    fn sent(size_bytes: usize) -> (Vec<u8>, bool) {
        let client = Client::new("http://127.0.0.1:1").expect("an address");
        let request = attach(client.request(Method::POST, "/v1/jobs"), vec![b' '; size_bytes]);
        let request = request.build().expect("a request");
        assert_eq!(request.headers()[CONTENT_TYPE], "application/json");
        let encoding = request.headers().get(CONTENT_ENCODING).map(|value| value == "gzip");
        (request.body().and_then(reqwest::Body::as_bytes).expect("bytes").to_vec(), encoding.unwrap_or(false))
    }

    #[test]
    fn large_job_files_are_compressed() {
        assert_eq!(sent(MAX_PLAIN_BYTES), (vec![b' '; MAX_PLAIN_BYTES], false));
        let (body, is_compressed) = sent(MAX_PLAIN_BYTES + 1);
        assert!(is_compressed && body.len() < MAX_PLAIN_BYTES / 10, "{} bytes", body.len());
        let mut unpacked = Vec::new();
        GzDecoder::new(&body[..]).read_to_end(&mut unpacked).expect("gzip");
        assert_eq!(unpacked, vec![b' '; MAX_PLAIN_BYTES + 1]);
    }
}
