//! Process-level tests: the real binary, over HTTP and on the command line.
//!
//! They see only what a user sees; what is inside is tested beside the code.

mod api;
mod bad_input;
mod bad_requests;
mod command_line;
mod cuda;
mod doors;
mod exr_reader;
mod faults;
mod follow;
mod fuzz;
mod jobs;
mod kills;
mod operating;
mod pictures;
mod previews;
mod same_bits;
mod support;
mod tidy;
