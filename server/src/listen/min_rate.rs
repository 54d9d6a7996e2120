//! Minimum transfer rates: for request bodies, and for clients that read responses.
//!
//! A transfer may stall for at most 20 s in total, plus one second for each second's bytes at the minimum rate:
//! a body of 32 MiB holds its memory for at most 18 minutes. At most 20 s are saved up.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use bytes::Bytes;
use hyper::body::{Body as HttpBody, Frame, Incoming, SizeHint};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep};

use super::connection_limit::Unsent;
use crate::clock::monotonic_now;

/// Maximum stall.
const MAX_STALL: Duration = Duration::from_secs(20);
/// Minimum rate of a request's body.
const MIN_BODY_BYTES_PER_SECOND: f64 = 32.0 * 1024.0;
/// Minimum rate at which a client reads a response.
const MIN_READER_BYTES_PER_SECOND: f64 = 1024.0;

/// Remaining time budget of a transfer.
#[derive(Debug)]
struct MinRateTimer {
    left: Duration,
    max_pause: Duration,
    min_bytes_per_second: f64,
    since: Option<Instant>,
    alarm: Option<Pin<Box<Sleep>>>,
}

impl MinRateTimer {
    fn new(max_pause: Duration, min_bytes_per_second: f64) -> Self {
        Self { left: max_pause, max_pause, min_bytes_per_second, since: None, alarm: None }
    }

    /// Call when nothing was transferred; ready when the budget is used up.
    fn poll_expired(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        if self.since.is_none() {
            let now = monotonic_now();
            self.since = Some(now);
            match &mut self.alarm {
                Some(alarm) => alarm.as_mut().reset(now + self.left),
                None => self.alarm = Some(Box::pin(tokio::time::sleep_until(now + self.left))),
            }
        }
        match &mut self.alarm {
            Some(alarm) => alarm.as_mut().poll(cx),
            None => Poll::Pending,
        }
    }

    /// Adds the budget earned by this many bytes.
    fn add_bytes(&mut self, size_bytes: usize) {
        if let Some(since) = self.since.take() {
            self.left = self.left.saturating_sub(since.elapsed());
        }
        let earned = Duration::from_secs_f64(size_bytes as f64 / self.min_bytes_per_second);
        self.left = (self.left + earned).min(self.max_pause);
    }
}

/// Error of a body that arrives too slowly.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("it arrived too slowly")]
pub(crate) struct SlowBody;

/// Request body that must keep up a minimum rate while the server waits for it.
#[derive(Debug)]
pub(super) struct TimedBody {
    body: Incoming,
    timer: MinRateTimer,
}

impl TimedBody {
    pub(super) fn new(body: Incoming) -> Self {
        Self { body, timer: MinRateTimer::new(MAX_STALL, MIN_BODY_BYTES_PER_SECOND) }
    }
}

impl HttpBody for TimedBody {
    type Data = Bytes;
    type Error = axum::BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::BoxError>>> {
        match Pin::new(&mut self.body).poll_frame(cx) {
            Poll::Ready(frame) => {
                let size_bytes = match &frame {
                    Some(Ok(frame)) => frame.data_ref().map_or(0, Bytes::len),
                    Some(Err(_)) | None => 0,
                };
                self.timer.add_bytes(size_bytes);
                Poll::Ready(frame.map(|frame| frame.map_err(Into::into)))
            }
            Poll::Pending => {
                ready!(self.timer.poll_expired(cx));
                Poll::Ready(Some(Err(SlowBody.into())))
            }
        }
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// Connection whose client must read responses at a minimum rate.
#[derive(Debug)]
pub(super) struct TimedStream<S> {
    stream: S,
    timer: MinRateTimer,
    unsent: Unsent,
}

impl<S> TimedStream<S> {
    /// Connection that clears `unsent` when everything is written to the socket.
    pub(super) fn new(stream: S, unsent: Unsent) -> Self {
        Self { stream, timer: MinRateTimer::new(MAX_STALL, MIN_READER_BYTES_PER_SECOND), unsent }
    }

    fn poll_with_timer<T>(
        &mut self,
        cx: &mut Context<'_>,
        polled: Poll<io::Result<T>>,
        size_bytes: impl FnOnce(&T) -> usize,
    ) -> Poll<io::Result<T>> {
        match polled {
            Poll::Ready(done) => {
                self.timer.add_bytes(done.as_ref().map_or(0, size_bytes));
                Poll::Ready(done)
            }
            Poll::Pending => {
                ready!(self.timer.poll_expired(cx));
                Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, "the client does not read its response")))
            }
        }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for TimedStream<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buffer)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for TimedStream<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.poll_with_timer(cx, polled, |&size_bytes| size_bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write_vectored(cx, slices);
        self.poll_with_timer(cx, polled, |&size_bytes| size_bytes)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        // hyper flushes the stream only when its own buffer is empty.
        let polled = Pin::new(&mut self.stream).poll_flush(cx);
        if let Poll::Ready(Ok(())) = polled {
            self.unsent.clear();
        }
        self.poll_with_timer(cx, polled, |()| 0)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.stream).poll_shutdown(cx);
        self.poll_with_timer(cx, polled, |()| 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn min_rate_timer_counts_stalls_and_bytes() {
        let seconds = Duration::from_secs;
        let mut timer = MinRateTimer::new(seconds(10), 1024.0);
        let mut waited = |size_bytes: usize| {
            timer.since = Some(monotonic_now() - seconds(6));
            timer.add_bytes(size_bytes);
            timer.left
        };
        assert!(waited(0) <= seconds(4));
        assert!(waited(3 << 10) <= seconds(3), "an expired budget is not refilled");
        assert!(waited(1 << 30) == seconds(10), "the budget is at most the maximum stall");
        assert!(waited(1) < seconds(5), "one byte per stall is too slow");
    }
}
