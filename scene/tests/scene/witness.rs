//! Pictures against what is known by other means: double precision, or a value worked out by hand.

#![expect(clippy::disallowed_methods, reason = "the witness computes in f64 by std's functions")]

mod corrections;
mod depth;
mod double;
