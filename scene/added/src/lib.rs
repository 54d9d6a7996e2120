//! The crates of `scene/` compiled once more, as one, with one more kind of each family: what the tests prove about a
//! kind that takes a file of its own and a line in the family's list.

#![expect(
    unused_imports,
    unreachable_pub,
    reason = "what the crates take from each other and re-export is at this root anyway"
)]

extern crate self as language;
extern crate self as math;
extern crate self as picture;
extern crate self as trace;

#[path = "../../language/src/lib.rs"]
mod language_sources;
#[path = "../../math/src/lib.rs"]
mod math_sources;
#[path = "../../picture/src/lib.rs"]
mod picture_sources;
#[path = "../../src/lib.rs"]
mod scene_sources;
#[path = "../../trace/src/lib.rs"]
mod trace_sources;

pub use language_sources::*;
pub use math_sources::*;
pub use picture_sources::*;
pub use scene_sources::*;
pub use trace_sources::*;
