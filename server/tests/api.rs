//! The server through its HTTP door, with workers that only pretend to render.

mod api {
    mod bad_input;
    pub(crate) mod harness;
    mod images;
    mod jobs;
    mod leases;
    mod life;
    mod load;
    mod nodes;
    mod pool;
    mod watch;
}
