//! The server through its HTTP door, with workers that only pretend to render.

#[path = "../../tests/skip.rs"]
mod skip;

mod api {
    mod bad_input;
    mod change;
    mod clocks;
    mod connections;
    mod events;
    mod files;
    mod frames;
    pub(crate) mod harness;
    mod images;
    mod jobs;
    pub(crate) mod keys;
    mod leases;
    mod life;
    mod links;
    mod load;
    mod matrix;
    mod nodes;
    mod pool;
    mod previews;
    mod queue;
    mod retention;
    mod start_page;
    mod watch;
    mod webhooks;
    mod wish;
}
