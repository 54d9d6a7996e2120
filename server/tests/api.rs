//! The server through its HTTP door, with workers that only pretend to render.

mod api {
    pub(crate) mod harness;
    mod bad_input;
    mod images;
    mod jobs;
    mod leases;
    mod life;
    mod load;
}
