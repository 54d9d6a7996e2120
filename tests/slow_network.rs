//! A slow and unreliable network between a server and its database: a TCP proxy on loopback that delays and cuts
//! connections.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A proxy; its threads end with the test.
pub(crate) struct SlowNetwork {
    target: String,
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    /// Longest delay of a piece, in microseconds.
    longest_us: AtomicU64,
    is_cut: AtomicBool,
    /// State of the random numbers.
    random_state: AtomicU64,
    open: Mutex<Vec<TcpStream>>,
}

impl SlowNetwork {
    /// Forwards connections to a database at an address such as `postgres://sdfarm@127.0.0.1:5432/farm`.
    pub(crate) fn to(database: &str, longest: Duration) -> Self {
        let host =
            database.split('@').nth(1).and_then(|rest| rest.split('/').next()).expect("host and port").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("an address").port();
        let shared = Arc::new(Shared::default());
        shared.longest_us.store(longest.as_micros() as u64, Ordering::Relaxed);
        let (accepting, to) = (Arc::clone(&shared), host.clone());
        std::thread::spawn(move || {
            for client in listener.incoming().flatten() {
                // Dropped connections are closed.
                if !accepting.is_cut.load(Ordering::Relaxed)
                    && let Ok(server) = TcpStream::connect(&to)
                {
                    accepting.connect(&client, &server);
                }
            }
        });
        Self { target: database.replace(&host, &format!("127.0.0.1:{port}")), shared }
    }

    /// Address of the database through the proxy.
    pub(crate) fn address(&self) -> &str {
        &self.target
    }

    /// Cuts all connections, and refuses new ones until it is mended.
    pub(crate) fn cut(&self) {
        self.shared.is_cut.store(true, Ordering::Relaxed);
        for stream in self.shared.open.lock().expect("no holder panics").drain(..) {
            // It may have ended already.
            drop(stream.shutdown(Shutdown::Both));
        }
    }

    /// Accepts connections again.
    pub(crate) fn mend(&self) {
        self.shared.is_cut.store(false, Ordering::Relaxed);
    }
}

impl Shared {
    fn connect(self: &Arc<Self>, client: &TcpStream, server: &TcpStream) {
        for (from, to) in [(client, server), (server, client)] {
            drop(from.set_nodelay(true));
            let (mut from, mut to) = (from.try_clone().expect("a handle"), to.try_clone().expect("a handle"));
            self.open.lock().expect("no holder panics").push(from.try_clone().expect("a handle"));
            let this = Arc::clone(self);
            std::thread::spawn(move || {
                let mut piece = vec![0; 1 << 16];
                while let Ok(length @ 1..) = from.read(&mut piece) {
                    std::thread::sleep(this.delay());
                    if to.write_all(&piece[..length]).is_err() {
                        break;
                    }
                }
                drop((from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both)));
            });
        }
    }

    /// Mostly short; one in fifty pieces is late by up to the longest delay.
    fn delay(&self) -> Duration {
        let longest_us = self.longest_us.load(Ordering::Relaxed);
        // A linear congruential generator (Knuth's MMIX).
        let step = |state: u64| state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let state = self.random_state.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |state| Some(step(state)));
        let random = state.unwrap_or_default() >> 33;
        let most_us = if random.is_multiple_of(50) { longest_us } else { longest_us / 100 };
        Duration::from_micros(random % most_us.max(1))
    }
}
