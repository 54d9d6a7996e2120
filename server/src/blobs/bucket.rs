//! Opening a bucket of an S3 store: settings from the environment, and the check before a server serves.

use std::time::Duration;

use futures_util::stream::TryStreamExt;
use object_store::aws::{AmazonS3, AmazonS3Builder, AmazonS3ConfigKey};
use object_store::path::Path;
use object_store::{BackoffConfig, ClientConfigKey, ObjectStore, ObjectStoreExt, PutMode, PutOptions, RetryConfig};

use super::StoreLocation;
use super::bounded_answers::BoundedConnector;
use super::error::{BucketFault, causes};
use super::objects::small;

/// Maximum time in which a request that fails is sent again: afterwards the server answers that the store cannot be
/// reached, and its client asks again. A worker's sync must be answered before the worker gives up on it.
const RETRY_TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum number of times that a request is sent again.
const MAX_RETRIES: usize = 16;
/// Delay before the first of them, and before the last.
const BACK_OFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(1));
/// Time in which a store must send the next bytes, and in which it must have taken a part and answered.
const READ_TIMEOUT: &str = "60 seconds";
/// Time in which a picture must have been read: as long as the slowest client takes it.
const REQUEST_TIMEOUT: &str = "24 hours";
/// Maximum time of the check at the start.
const CHECK_TIMEOUT: Duration = Duration::from_secs(30);
/// Retries in the check: wrong settings must be reported soon.
const CHECK_RETRIES: usize = 2;

/// Error returned when a bucket cannot be used, with its fix.
#[derive(Debug, thiserror::Error)]
#[error("the store {}; {}", self.problem(), self.cure())]
pub struct BucketError {
    store: String,
    endpoint: Option<String>,
    fault: BucketFault,
    detail: String,
}

fn at(endpoint: Option<&str>) -> String {
    endpoint.map(|endpoint| format!(" at {endpoint}")).unwrap_or_default()
}

impl BucketError {
    /// Message without the fix.
    pub(crate) fn problem(&self) -> String {
        let Self { store, endpoint, fault, detail } = self;
        format!("{store} cannot be used: {}{}{detail}", fault.reason(), at(endpoint.as_deref()))
    }

    /// Fix.
    pub(crate) fn cure(&self) -> &'static str {
        self.fault.cure()
    }

    /// Reason.
    #[cfg(test)]
    pub(super) fn fault(&self) -> BucketFault {
        self.fault
    }
}

/// A bucket's settings.
pub(super) struct Settings<'a> {
    location: &'a StoreLocation,
    builder: AmazonS3Builder,
}

impl<'a> Settings<'a> {
    /// Settings of the environment for a bucket.
    pub(super) fn from_env(location: &'a StoreLocation, bucket: &str) -> Self {
        // Clients of this process use one TLS library.
        proto::client_auth::install_crypto_provider();
        let client = |key| AmazonS3ConfigKey::Client(key);
        let builder = AmazonS3Builder::from_env()
            .with_bucket_name(bucket)
            .with_config(client(ClientConfigKey::ReadTimeout), READ_TIMEOUT)
            .with_config(client(ClientConfigKey::Timeout), REQUEST_TIMEOUT);
        Self { location, builder }
    }

    #[cfg(test)]
    pub(super) fn with(mut self, settings: &[(&str, String)]) -> Self {
        for (name, value) in settings {
            self.builder = self.builder.with_config(name.to_lowercase().parse().expect("a setting"), value);
        }
        self
    }

    #[cfg(test)]
    pub(super) fn without_retries(&self) -> AmazonS3 {
        self.build(0).expect("opens")
    }

    /// Opens the bucket without a request.
    pub(super) fn open(&self) -> Result<AmazonS3, BucketError> {
        self.build(MAX_RETRIES)
    }

    fn build(&self, max_retries: usize) -> Result<AmazonS3, BucketError> {
        let (init_backoff, max_backoff) = BACK_OFF;
        let backoff = BackoffConfig { init_backoff, max_backoff, base: 2.0 };
        let retry = RetryConfig { backoff, max_retries, retry_timeout: RETRY_TIMEOUT };
        let builder = self.builder.clone().with_retry(retry).with_http_connector(BoundedConnector);
        builder.build().map_err(|error| self.error(BucketFault::of(&error), &error))
    }

    fn error(&self, fault: BucketFault, error: &object_store::Error) -> BucketError {
        let last = causes(error).last().map_or_else(String::new, ToString::to_string);
        // The answer's body is XML: its code and its message tell everything.
        let detail = match (element(&last, "Code"), element(&last, "Message")) {
            (Some(code), Some(message)) => format!("{code}: {}", unescape(message).trim_end_matches('.')),
            _ => last,
        };
        self.fault(fault, format!(" ({detail})"))
    }

    fn fault(&self, fault: BucketFault, detail: String) -> BucketError {
        let endpoint = self.builder.get_config_value(&AmazonS3ConfigKey::Endpoint);
        BucketError { store: self.location.to_string(), endpoint, fault, detail }
    }

    /// Lists the bucket, and stores, reads and deletes a few bytes in it; the store must refuse to store them twice.
    pub(super) async fn check(&self) -> Result<(), BucketError> {
        let bucket = self.build(CHECK_RETRIES)?;
        match tokio::time::timeout(CHECK_TIMEOUT, check(&bucket, &self.location.prefix())).await {
            Ok(Ok(true)) => Ok(()),
            Ok(Ok(false)) => Err(self.fault(BucketFault::NoConditionalPut, String::new())),
            Ok(Err(error)) => Err(self.error(BucketFault::of(&error), &error)),
            Err(_) => {
                // Without keys, the time is spent looking for a cloud's metadata service.
                let has_key = self.builder.get_config_value(&AmazonS3ConfigKey::AccessKeyId).is_some();
                let fault = if has_key { BucketFault::Unreachable } else { BucketFault::KeysRefused };
                Err(self.fault(fault, format!(" (no answer within {} s)", CHECK_TIMEOUT.as_secs())))
            }
        }
    }
}

/// Text of the first XML element of this name.
fn element<'a>(xml: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = xml.split_once(&format!("<{name}>"))?;
    Some(rest.split_once(&format!("</{name}>"))?.0)
}

/// Text of XML without references to characters.
fn unescape(xml: &str) -> String {
    let named = [("&#39;", "'"), ("&apos;", "'"), ("&#34;", "\""), ("&quot;", "\""), ("&lt;", "<"), ("&gt;", ">")];
    let text = named.iter().fold(xml.to_owned(), |text, (name, character)| text.replace(name, character));
    text.replace("&amp;", "&")
}

/// Whether a bucket creates an object only if it is absent.
async fn check(bucket: &AmazonS3, prefix: &Path) -> object_store::Result<bool> {
    // A missing bucket is found first, because some stores create one for an object. One page tells it.
    match bucket.list(Some(prefix)).try_next().await {
        // Somebody else's object, whose name this client does not take.
        Ok(_) | Err(object_store::Error::InvalidPath { .. }) => {}
        Err(error) => return Err(error),
    }
    let text = uuid::Uuid::now_v7().to_string();
    let probe = prefix.clone().join("probe").join(text.as_str());
    let create = || bucket.put_opts(&probe, text.clone().into(), PutOptions::from(PutMode::Create));
    create().await?;
    let again = create().await;
    let read = small(bucket.get(&probe).await?).await;
    bucket.delete(&probe).await?;
    match again {
        Err(object_store::Error::AlreadyExists { .. }) => Ok(read? == text.as_bytes()),
        Ok(_) => Ok(false),
        Err(error) => Err(error),
    }
}
