//! Tests of the server over HTTP, with workers that only pretend to render.

#[path = "../../tests/postgres_server.rs"]
mod postgres_server;
#[path = "../../tests/skip.rs"]
mod skip;

mod api {
    mod alerts;
    mod bad_input;
    mod bodies;
    mod caller;
    mod clocks;
    mod connections;
    mod deliveries;
    mod documented;
    mod editing;
    mod events;
    pub(crate) mod fake_pictures;
    mod farm_events;
    mod files;
    mod frames;
    pub(crate) mod harness;
    mod history;
    mod idempotency;
    mod images;
    mod job_changes;
    mod jobs;
    pub(crate) mod keys;
    mod leases;
    mod links;
    mod load;
    mod metrics;
    mod nodes;
    mod permissions;
    mod pool;
    mod postgres;
    mod previews;
    mod queue;
    mod quotas;
    mod retention;
    mod scaling;
    mod start_page;
    mod startup;
    mod store;
    mod tiles;
    mod verification;
    mod webhooks;
    mod witnesses;
    mod worker_changes;
    mod worker_keys;
}
