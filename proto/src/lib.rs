//! Types that the parts of sdfarm exchange: ids, jobs as users see them, tiles, the workers' protocol,
//! problems, and a typed client.
//!
//! Nothing here renders, stores or decides.
//!
//! ```
//! use proto::tile::Tiling;
//! use proto::{JobId, Rect};
//!
//! // Tiles cover a frame; those at its right and bottom edge may be smaller.
//! let tiling = Tiling { width: 1920, height: 1080, samples: 64, pixel_bytes: 16, tile_edge: Some(500) };
//! let tiles = tiling.tiles();
//! assert_eq!(tiles.len(), 12);
//! assert_eq!(tiles[0], Rect { x: 0, y: 0, width: 512, height: 512 });
//! assert_eq!(tiles[11], Rect { x: 1536, y: 1024, width: 384, height: 56 });
//! assert_eq!(tiles.iter().map(|tile| tile.pixels()).sum::<u64>(), 1920 * 1080);
//!
//! // Later ids sort after earlier ones.
//! let (first, second) = (JobId::new(), JobId::new());
//! assert!(first < second && first.to_string().parse() == Ok(first));
//! ```

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
