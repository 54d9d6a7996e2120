//! The sdfarm binary: parses the command line, starts logs, and turns errors into messages on stderr and exit
//! codes (0 done, 1 failed, 2 usage error or bad input, 3 unusable device of a worker).
//!
//! The commands are in `commands`; nothing here renders or serves.

mod arguments;
mod commands;
mod counted;
mod error;
mod follow;
mod frame_files;
mod frame_list;
mod job_file;
mod job_name;
mod logs;
mod output_file;
mod overrides;
mod overview;
mod progress;
mod shipped;
mod signals;
mod size;
mod systemd;
mod terminal;

use std::process::ExitCode;

use clap::Parser;
use proto::fail_point;

use crate::commands::Command;
use crate::error::UsageError;

const EXAMPLES: &str = "\
Examples:
  sdfarm demo                               a picture from nothing, in one command
  sdfarm render scenes/csg.json -o csg.png  without a server
  sdfarm serve                              a farm at http://127.0.0.1:8080, its API at /docs
  sdfarm submit scenes/csg.json --wait -o csg.png
  sdfarm pool 4                             four workers on this machine

Every flag can be given as a variable: --listen as SDFARM_LISTEN, and so on.
Exit codes: 0 done, 1 failed, 2 usage error or bad input, 3 unusable device of a worker.";

/// A render farm for scenes made of signed distance functions.
#[derive(Debug, Parser)]
#[command(name = "sdfarm", version, after_help = EXAMPLES)]
struct Sdfarm {
    #[command(flatten)]
    logs: logs::LogArguments,
    /// Allow `SDFARM_FAIL_POINTS` to arm fail points in this process and its children: for tests, see
    /// docs/proof.md.
    #[arg(long, hide = true, global = true)]
    allow_fail_points: bool,
    #[command(subcommand)]
    command: Command,
}

fn main() -> ExitCode {
    let sdfarm = Sdfarm::parse();
    let done = arm(sdfarm.allow_fail_points).and_then(|()| sdfarm.logs.start(sdfarm.command.is_long_lived())).and_then(
        |traces| {
            let done = sdfarm.command.run();
            // Dropping the guard sends the remaining traces.
            drop(traces);
            done
        },
    );
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => ExitCode::from(error::report(&error)),
    }
}

fn arm(is_allowed: bool) -> anyhow::Result<()> {
    if !is_allowed {
        return Ok(());
    }
    let list = std::env::var(fail_point::ENV_VAR).unwrap_or_default();
    fail_point::arm(&list).map_err(|wrong| UsageError(format!("{}: {wrong}", fail_point::ENV_VAR)).into())
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn command_line_is_valid() {
        super::Sdfarm::command().debug_assert();
    }

    #[test]
    fn every_flag_has_a_variable() {
        for command in super::Sdfarm::command().get_subcommands() {
            for argument in command.get_arguments().filter(|argument| argument.get_long().is_some()) {
                let long = argument.get_long().expect("filtered above");
                if ["help", "version"].contains(&long) || argument.is_hide_set() {
                    continue;
                }
                let want = format!("SDFARM_{}", long.replace('-', "_").to_uppercase());
                let got = argument.get_env().map(|name| name.to_string_lossy().into_owned());
                assert_eq!(got.as_deref(), Some(want.as_str()), "--{long} of {}", command.get_name());
            }
        }
    }
}
