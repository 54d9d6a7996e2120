//! Types that the parts of sdfarm exchange: ids, jobs as users see them, tiles, the workers' protocol,
//! problems, and a typed client.
//!
//! Nothing here renders, stores or decides.

pub mod alert;
pub mod api_key;
pub mod audit;
pub mod bounded;
pub mod caller;
pub mod client;
pub mod client_auth;
pub mod event;
pub mod fail_point;
pub mod farm;
pub mod frame;
pub mod history;
pub mod ids;
pub mod job;
pub mod link;
pub mod plain_text;
pub mod pool;
pub mod preview_helper;
pub mod price;
pub mod problem;
pub mod retention;
pub mod rounding;
pub mod scaling;
pub mod shipped_scenes;
pub mod tile;
pub mod tile_history;
pub mod trace_context;
pub mod verify;
pub mod webhook;
pub mod worker_protocol;

pub use client::{Client, ClientError};
pub use client_auth::{ClientAuth, ClientAuthError, Secret};
pub use ids::{JobId, LeaseId, WorkerId};
pub use problem::Problem;
pub use retention::Retention;
pub use tile::Rect;
