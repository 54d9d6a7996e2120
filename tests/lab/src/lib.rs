//! Proofs and measurements that only contributors run: soaks, the queue's throughput, simulated farms, the paper's table,
//! and straight C++ beside the evaluators.
//!
//! It drives a real `sdfarm` where a process is under test. No release has it, and no shipped program depends on it.

mod paper;
mod program;
mod queue;
mod setup;
mod simulate;
#[cfg(test)]
#[path = "../../skip.rs"]
mod skip;
mod soak;
mod straight;

use clap::{Parser, Subcommand};

use crate::program::Program;

/// Proofs and measurements of sdfarm, for its contributors.
#[derive(Debug, Parser)]
#[command(name = "sdfarm-lab", version)]
pub struct Lab {
    #[command(flatten)]
    program: Program,
    #[command(subcommand)]
    command: Command,
}

/// A proof or a measurement.
#[derive(Debug, Subcommand)]
enum Command {
    /// Stress-test a temporary farm: kill its processes repeatedly and check that nothing is lost or changed.
    Soak(soak::Arguments),
    /// Measure a server's queue: jobs and tiles per second, and response times.
    Queue(queue::Arguments),
    /// Simulate farms in virtual time, with the real queue, and measure how well workers are used.
    Simulate(simulate::Arguments),
    /// Measure the paper's Table 1 on this machine, next to the published figures.
    Paper(paper::Arguments),
    /// Measure distances per second beside straight C++ of the same distance.
    Straight(straight::Arguments),
    /// Measure how long an animated job takes to read, and to evaluate at a frame.
    Setup(setup::Arguments),
}

impl Lab {
    /// Gives the processes under test these variables.
    #[must_use]
    pub fn with_environment<'a>(mut self, variables: impl IntoIterator<Item = (&'a str, String)>) -> Self {
        self.program.set_environment(variables);
        self
    }

    /// Runs the command; returns its result as text. A violation is an error.
    pub async fn run(self) -> anyhow::Result<String> {
        match self.command {
            Command::Soak(arguments) => soak::run(&arguments, &self.program).await,
            Command::Queue(arguments) => queue::run(&arguments, &self.program).await,
            Command::Simulate(arguments) => simulate::run(&arguments).await,
            Command::Paper(arguments) => paper::run(&arguments, &self.program),
            Command::Straight(arguments) => straight::run(&arguments),
            Command::Setup(arguments) => setup::run(&arguments),
        }
    }
}
