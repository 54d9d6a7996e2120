//! Types that the parts of sdfarm exchange: ids, jobs as users see them, tiles, the workers' protocol,
//! problems, and a typed client.
//!
//! Nothing here renders, stores or decides.

pub mod access;
pub mod change;
pub mod client;
pub mod event;
pub mod fail;
pub mod farm;
pub mod ids;
pub mod job;
pub mod keep;
pub mod key;
pub mod link;
pub mod pool;
pub mod problem;
pub mod retention;
pub mod sketch;
pub mod tile;
pub mod trace;
pub mod webhook;
pub mod work;

pub use access::{Access, AccessError, Secret};
pub use client::{Client, ClientError};
pub use ids::{JobId, LeaseId, WorkerId};
pub use keep::Keep;
pub use problem::Problem;
pub use tile::Rect;
