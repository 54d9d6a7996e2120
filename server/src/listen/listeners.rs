//! Listening addresses: the public one, and with TLS another on loopback for the server's own workers, because
//! no certificate names loopback.

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;

use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use super::tls::TlsError;
use super::{ConnectionLimit, Tls, connection_limit, serve};
use crate::config::Config;

/// Maximum number of connections of the server's own workers.
const POOL_CONNECTIONS: usize = 4096;

/// Error when the listeners are opened.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ListenError {
    /// The certificate cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The address cannot be bound.
    #[error("cannot listen on {address}")]
    Bind {
        /// The address.
        address: SocketAddr,
        /// Error of the system.
        #[source]
        source: io::Error,
    },
}

/// Listeners of a server.
#[derive(Debug)]
pub(crate) struct Listeners {
    public: TcpListener,
    address: SocketAddr,
    tls: Option<Arc<Tls>>,
    pool: Option<(TcpListener, SocketAddr)>,
    connections: usize,
    limit: Arc<ConnectionLimit>,
}

impl Listeners {
    /// Binds the addresses, and reads the certificate.
    pub(crate) async fn open(config: &Config) -> Result<Self, ListenError> {
        let tls = match &config.tls {
            Some(files) => Some(Arc::new(Tls::open(&files.certificate, &files.key)?)),
            None => None,
        };
        let (public, address) = bind(config.listen).await?;
        let pool = match &tls {
            Some(_) => Some(bind((Ipv4Addr::LOCALHOST, 0).into()).await?),
            None => None,
        };
        let connections = connection_limit(config.max_connections);
        let of_address = config.max_connections_per_address.map_or(connections / 4, |limit| limit as usize);
        let limit = ConnectionLimit::new(connections, of_address.max(1));
        Ok(Self { public, address, tls, pool, connections, limit })
    }

    /// Maximum number of open connections.
    pub(crate) fn connections(&self) -> usize {
        self.connections
    }

    /// Public address.
    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Address for the server's own workers, without TLS.
    pub(crate) fn pool_address(&self) -> SocketAddr {
        self.pool.as_ref().map_or(self.address, |(_, address)| *address)
    }

    /// Serves until `ending`, and until requests in progress have been answered.
    pub(crate) async fn serve(self, router: axum::Router, ending: CancellationToken) -> io::Result<()> {
        let Self { public, tls, pool, limit, .. } = self;
        let follow = async {
            if let Some(tls) = &tls {
                tls.watch_files(ending.clone()).await;
            }
            // The accept loops decide when to stop.
            std::future::pending::<()>().await;
        };
        let inside = async {
            match pool {
                Some((listener, _)) => {
                    let limit = ConnectionLimit::new(POOL_CONNECTIONS, POOL_CONNECTIONS);
                    serve(listener, None, router.clone(), limit, ending.clone()).await
                }
                None => Ok(()),
            }
        };
        let outside = serve(public, tls.clone(), router.clone(), limit, ending.clone());
        let served = async { tokio::try_join!(inside, outside).map(drop) };
        tokio::select! {
            served = served => served,
            () = follow => Ok(()),
        }
    }
}

async fn bind(address: SocketAddr) -> Result<(TcpListener, SocketAddr), ListenError> {
    let wrong = |source| ListenError::Bind { address, source };
    let listener = TcpListener::bind(address).await.map_err(wrong)?;
    let bound = listener.local_addr().map_err(wrong)?;
    Ok((listener, bound))
}
