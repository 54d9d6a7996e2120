//! Process-level tests: the real binary, over HTTP and on the command line.
//! They use only what users can use; internals are tested next to the code.

mod abuse;
mod access_control;
mod api;
mod attacks;
mod bad_input;
mod bad_requests;
mod bit_identical;
mod bucket;
mod chart;
mod command_line;
mod compose;
mod cuda;
mod documented;
mod executable_memory;
mod exr_reader;
mod faults;
mod first_steps;
mod follow;
mod fuzz;
mod job_files;
mod jobs;
mod kills;
mod openjd;
mod operating;
mod pages;
mod pictures;
mod postgres;
mod postgres_server;
mod previews;
mod repository;
mod runaway;
mod schema_readers;
mod seaweedfs;
mod skip;
mod support;
