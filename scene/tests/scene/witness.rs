//! Pictures compared with independent results: double precision, or values calculated by hand.

#![expect(clippy::disallowed_methods, reason = "the witness computes in f64 by std's functions")]

mod corrections;
mod depth;
mod double;
