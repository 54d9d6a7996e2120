//! The server's connections: accepted, bounded in number and by minimum rates, closed gracefully.
//!
//! Slow, silent or surplus connections never reach a handler. This module decides nothing about requests.

mod connection_limit;
mod file_limit;
mod listeners;
mod min_rate;
mod tls;

use std::convert::Infallible;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::response::Response;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use rustix::io::Errno;
use socket2::SockRef;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

use crate::admission::ResponseShares;
use connection_limit::ConnectionLimit;
use connection_limit::{ConnectionSlot, TrackedBody, Unsent};
use file_limit::connection_limit;
pub(crate) use listeners::{ListenError, Listeners};
pub(crate) use min_rate::SlowBody;
use min_rate::{TimedBody, TimedStream};
use tls::Tls;

/// Time limit for a request's head, and for an idle connection.
const HEAD_TIMEOUT: Duration = Duration::from_secs(30);
/// A request's line and headers.
const MAX_HEAD_BYTES: usize = 32 << 10;
/// Read-ahead buffer of a connection, and the size above which no more of a response is buffered. With the chunk
/// in progress, a client that does not read its response costs less than 128 KiB.
const MAX_BUFFER_BYTES: usize = MAX_HEAD_BYTES;
/// Bytes of a connection that the kernel buffers in addition to those that the client's side has room for.
const MAX_UNSENT_BYTES: u32 = 32 << 10;
/// Maximum number of headers of a request.
const MAX_HEADERS: usize = 100;
/// Time limit for a TLS handshake.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(10);
/// Time in which an evicted connection may still become busy.
const CLOSE_GRACE: Duration = Duration::from_millis(250);
/// If no slot is free, the next attempt is made after this interval.
const ACCEPT_RETRY_DELAY: Duration = Duration::from_millis(100);

/// Address of the client, as an extension of each request.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Peer(pub(crate) IpAddr);

/// Accepts connections until `ending`, then waits until busy ones have been answered.
pub(crate) async fn serve(
    listener: TcpListener,
    tls: Option<Arc<Tls>>,
    router: axum::Router,
    limit: Arc<ConnectionLimit>,
    ending: CancellationToken,
) -> io::Result<()> {
    let connections = TaskTracker::new();
    let failed = loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = ending.cancelled() => break None,
        };
        let (stream, address) = match accepted {
            Ok(accepted) => accepted,
            Err(error) if is_listener_error(&error) => break Some(error),
            Err(error) => {
                tracing::warn!(%error, "could not accept a connection");
                limit.evict_idle();
                tokio::time::sleep(ACCEPT_RETRY_DELAY).await;
                continue;
            }
        };
        let place = tokio::select! {
            place = limit.acquire(canonical(address.ip())) => place,
            () = ending.cancelled() => break None,
        };
        let Some(place) = place else {
            tracing::debug!(%address, "closed a connection: its address has too many");
            continue;
        };
        // Small responses must not wait for one another.
        drop(stream.set_nodelay(true));
        // Bytes that a client does not receive stay outside the kernel's buffers, where they are counted.
        drop(SockRef::from(&stream).set_tcp_notsent_lowat(MAX_UNSENT_BYTES));
        let (router, tls, ending) = (router.clone(), tls.clone(), ending.clone());
        connections.spawn(async move {
            match tls {
                None => serve_connection(stream, address, router, &place, &ending).await,
                Some(tls) => {
                    let handshake = tokio::select! {
                        shaken = tokio::time::timeout(HANDSHAKE_TIMEOUT, tls.accept(stream)) => shaken,
                        () = place.evicted() => return,
                        () = ending.cancelled() => return,
                    };
                    match handshake {
                        Ok(Ok(stream)) => serve_connection(stream, address, router, &place, &ending).await,
                        Ok(Err(error)) => tracing::debug!(%address, %error, "TLS handshake failed"),
                        Err(_) => tracing::debug!(%address, "TLS handshake timed out"),
                    }
                }
            }
        });
    };
    drop(listener);
    connections.close();
    connections.wait().await;
    failed.map_or(Ok(()), Err)
}

/// Whether the listener itself failed, rather than one connection or a resource limit.
fn is_listener_error(error: &io::Error) -> bool {
    matches!(Errno::from_io_error(error), Some(Errno::BADF | Errno::INVAL | Errno::NOTSOCK | Errno::FAULT))
}

/// Serves one connection.
async fn serve_connection<S>(
    stream: S,
    address: SocketAddr,
    router: axum::Router,
    place: &ConnectionSlot,
    ending: &CancellationToken,
) where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let peer = canonical(address.ip());
    let unsent = Unsent::default();
    let service = service_fn(|request: hyper::Request<Incoming>| {
        let busy = place.begin_request();
        let mut request = request.map(|body| Body::new(TimedBody::new(body)));
        request.extensions_mut().insert(Peer(peer));
        let answer = router.clone().oneshot(request);
        let unsent = unsent.clone();
        async move {
            let mut answer: Response = answer.await?;
            let shares = answer.extensions_mut().remove::<ResponseShares>();
            Ok::<_, Infallible>(answer.map(|body| TrackedBody::new(body, busy, shares, unsent)))
        }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIMEOUT)
        .max_headers(MAX_HEADERS)
        .max_header_size(MAX_HEAD_BYTES)
        .max_buf_size(MAX_BUFFER_BYTES)
        .serve_connection(TokioIo::new(TimedStream::new(stream, unsent.clone())), service);
    let mut connection = pin!(connection);
    tokio::select! {
        ended = connection.as_mut() => return tell(address, ended),
        () = place.evicted() => {}
        () = ending.cancelled() => {}
    }
    connection.as_mut().graceful_shutdown();
    loop {
        tokio::select! {
            ended = connection.as_mut() => return tell(address, ended),
            () = tokio::time::sleep(CLOSE_GRACE) => if !place.is_busy() { return },
        }
    }
}

fn tell(address: SocketAddr, ended: hyper::Result<()>) {
    if let Err(error) = ended {
        tracing::debug!(%address, %error, "connection failed");
    }
}

/// The IPv4 address of an IPv4-mapped IPv6 address; others unchanged.
fn canonical(address: IpAddr) -> IpAddr {
    address.to_canonical()
}
