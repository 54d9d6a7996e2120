//! Errors when storing or reading content, with the cure where the store is a bucket.

use std::error::Error;
use std::io;

use object_store::client::{HttpError, HttpErrorKind};

use super::BucketError;

/// Error returned when a store cannot be opened.
#[derive(Debug, thiserror::Error)]
pub(crate) enum OpenStoreError {
    /// The folder cannot be used.
    #[error(transparent)]
    Folder(#[from] io::Error),
    /// The bucket cannot be used.
    #[error(transparent)]
    Bucket(#[from] BucketError),
}

/// Error when storing or reading bytes.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ContentError {
    /// The disk or the bucket failed.
    #[error("{attempt}{}", .cure.map(|cure| format!("; {cure}")).unwrap_or_default())]
    Store {
        /// The store, the attempted action and the content.
        attempt: String,
        /// Fix, for a bucket.
        cure: Option<&'static str>,
        /// Error of the object store.
        #[source]
        source: Box<object_store::Error>,
    },
    /// The bytes do not match the hash in their name.
    #[error("the bytes do not match {expected}: their BLAKE3 is {actual}")]
    Mismatch {
        /// Hash in the given name.
        expected: String,
        /// Hash of the bytes.
        actual: String,
    },
    /// The content is too large.
    #[error("there are more than {limit_bytes} bytes")]
    TooLarge {
        /// Maximum size.
        limit_bytes: u64,
    },
    /// The stream was interrupted.
    #[error("the stream of bytes was interrupted")]
    Broken(#[source] io::Error),
}

impl ContentError {
    /// The attempted action if the store did not answer, or answered that it cannot do anything for now: the same request
    /// may succeed later.
    pub(crate) fn unreachable_attempt(&self) -> Option<&str> {
        let Self::Store { attempt, source, .. } = self else { return None };
        BucketFault::of(source).is_temporary().then_some(attempt)
    }

    /// Whether the disk, or the quota, is full.
    pub(crate) fn is_full(&self) -> bool {
        let Self::Store { source, .. } = self else { return false };
        causes(source.as_ref()).any(|error| {
            error
                .downcast_ref::<io::Error>()
                .is_some_and(|error| matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded))
        })
    }
}

/// Reason for which a bucket cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BucketFault {
    /// There is no such bucket.
    NoBucket,
    /// There are no keys, they are wrong, or they do not permit the request.
    KeysRefused,
    /// Nothing answers at the endpoint, or it does not answer in time.
    Unreachable,
    /// The endpoint answers that it, or what is behind it, fails.
    Unavailable,
    /// This machine's clock differs too much from the endpoint's.
    ClockSkewed,
    /// The endpoint's address begins with `http://`, and that is not allowed.
    HttpNotAllowed,
    /// The endpoint cannot create an object only if it is absent.
    NoConditionalPut,
    /// The endpoint's certificate, protocol or answer is not that of an S3 store.
    Failed,
}

impl BucketFault {
    /// Reason behind an error of the object store.
    pub(crate) fn of(error: &object_store::Error) -> Self {
        let text = causes(error).map(ToString::to_string).collect::<Vec<_>>().join("\n");
        let says = |words: &[&str]| words.iter().any(|word| text.contains(word));
        let kind = causes(error).find_map(|error| error.downcast_ref::<HttpError>()).map(HttpError::kind);
        let is_late = || {
            let late = |error: &io::Error| error.kind() == io::ErrorKind::TimedOut;
            causes(error).any(|error| error.downcast_ref().is_some_and(late))
        };
        if says(&["URL scheme is not allowed"]) {
            Self::HttpNotAllowed
        } else if says(&["NoSuchBucket"]) {
            Self::NoBucket
        } else if says(&["RequestTimeTooSkewed"]) {
            Self::ClockSkewed
        } else if says(&["403 Forbidden", "401 Unauthorized", "AccessDenied", "InvalidAccessKeyId", "169.254.169.254"])
        {
            // Without keys, the object store asks the metadata service of a cloud's machine for some.
            Self::KeysRefused
        } else if says(&["501 Not Implemented"]) {
            Self::NoConditionalPut
        } else if says(&["status code: 5", "status code: 429"]) || says(&["InternalError", "SlowDown"]) {
            Self::Unavailable
        } else if is_late() || kind.is_some_and(is_connection_lost) {
            Self::Unreachable
        } else {
            Self::Failed
        }
    }

    /// Whether the same request may succeed later without any change of the settings.
    fn is_temporary(self) -> bool {
        match self {
            Self::Unreachable | Self::Unavailable => true,
            Self::NoBucket
            | Self::KeysRefused
            | Self::ClockSkewed
            | Self::HttpNotAllowed
            | Self::NoConditionalPut
            | Self::Failed => false,
        }
    }

    /// Reason, as a part of a sentence.
    pub(crate) fn reason(self) -> &'static str {
        match self {
            Self::NoBucket => "there is no such bucket",
            Self::KeysRefused => "the keys are missing, wrong, or not permitted to do this",
            Self::Unreachable => "its endpoint cannot be reached",
            Self::Unavailable => "its endpoint answers with an error of its own",
            Self::ClockSkewed => "this machine's clock differs too much from its own",
            Self::HttpNotAllowed => "its endpoint's address is not https, so that its pictures can be read on the way",
            Self::NoConditionalPut => {
                "its endpoint does not create an object only if it is absent (conditional PUT, `If-None-Match: *`)"
            }
            Self::Failed => "its endpoint did not answer as an S3 store does",
        }
    }

    /// Fix.
    pub(crate) fn cure(self) -> &'static str {
        match self {
            Self::NoBucket => "create the bucket, or correct --store, AWS_REGION and AWS_ENDPOINT_URL",
            Self::KeysRefused => {
                "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY to a key that may list the bucket, and read, write and \
                 delete its objects"
            }
            Self::Unreachable => {
                "correct AWS_ENDPOINT_URL (http or https, host and port), and check the network between this machine and the \
                 endpoint"
            }
            Self::Unavailable => "see the log of the endpoint; requests succeed again when it does",
            Self::ClockSkewed => "set the clocks of this machine and of the endpoint, for example by NTP",
            Self::HttpNotAllowed => "use an https address, or set AWS_ALLOW_HTTP=true if the network is trusted",
            Self::NoConditionalPut => "use a store that has it, such as Amazon S3, or a newer release of this one",
            Self::Failed => {
                "see the cause, and correct AWS_REGION and AWS_ENDPOINT_URL; the endpoint's log may say more"
            }
        }
    }
}

fn is_connection_lost(kind: HttpErrorKind) -> bool {
    use HttpErrorKind as Kind;
    matches!(kind, Kind::Connect | Kind::Timeout | Kind::Request | Kind::Interrupted)
}

/// Whether an error says that the object is missing, and not its bucket.
pub(super) fn is_missing(error: &object_store::Error) -> bool {
    matches!(error, object_store::Error::NotFound { .. }) && BucketFault::of(error) != BucketFault::NoBucket
}

/// An error and what caused it, the outermost first.
pub(crate) fn causes<'a>(error: &'a (dyn Error + 'static)) -> impl Iterator<Item = &'a (dyn Error + 'static)> {
    std::iter::successors(Some(error), |error: &&'a (dyn Error + 'static)| (*error).source())
}
