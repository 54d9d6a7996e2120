//! `sdfarm doctor`: checks a farm and its machine. Each finding that is not ok has a fix.

use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;

use clap::Args;
use serde_json::json;
use server::{Depth, Finding, Repair, Severity};

use crate::terminal::print_line;

/// Arguments of `doctor`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The farm's data folder; a server may be using it.
    #[arg(long, value_name = "FOLDER", env = "SDFARM_DATA", default_value = "./sdfarm-data")]
    data: PathBuf,
    /// Address that the server will listen on.
    #[arg(long, value_name = "ADDRESS:PORT", env = "SDFARM_LISTEN", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Read every byte of every picture.
    #[arg(long, env = "SDFARM_DEEP", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    deep: bool,
    /// Repair the data folder: delete orphans, and requeue the frames of missing pictures. No server may be running.
    #[arg(long, env = "SDFARM_REPAIR", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    repair: bool,
    /// Print the findings as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Runs the checks and prints the findings; an error finding fails the command.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let depth = if arguments.deep { Depth::Bytes } else { Depth::Names };
    let repair = if arguments.repair { Repair::Store } else { Repair::None };
    let mut findings = server::run_checks(&arguments.data, depth, repair).await?;
    let is_served =
        findings.iter().any(|finding| finding.subject == "server" && finding.message.starts_with("a server"));
    findings.push(check_port(arguments.listen, is_served));
    findings.push(check_gpus());
    if arguments.json {
        print_line(&serde_json::to_string_pretty(&findings.iter().map(to_json).collect::<Vec<_>>())?)?;
    } else {
        for finding in &findings {
            print_line(&line(finding))?;
        }
    }
    let wrong = findings.iter().filter(|finding| finding.severity == Severity::Error).count();
    anyhow::ensure!(wrong == 0, "{wrong} errors were found: see their fixes above");
    Ok(())
}

fn check_port(listen: SocketAddr, is_served: bool) -> Finding {
    match TcpListener::bind(listen) {
        Ok(_) => Finding::ok("port", format!("{listen} is free")),
        Err(_) if is_served => Finding::ok("port", format!("{listen} is in use, and the farm's server is running")),
        Err(error) => Finding::error(
            "port",
            format!("a server cannot listen on {listen}: {error}"),
            "stop the program that listens there, or choose another address with --listen",
        ),
    }
}

/// A machine without a GPU is ok; one with an unusable GPU gets a warning.
fn check_gpus() -> Finding {
    match worker::cuda::devices() {
        Ok(count) => Finding::ok("gpu", format!("the driver provides {count} GPUs")),
        Err(error) => {
            let has_one = std::path::Path::new("/proc/driver/nvidia/gpus").is_dir();
            if has_one {
                Finding::warning(
                    "gpu",
                    error.to_string(),
                    "install the NVIDIA driver and CUDA's run-time compiler, or render on the CPU",
                )
            } else {
                Finding::ok("gpu", "no GPU was found: workers render on the CPU")
            }
        }
    }
}

fn severity_name(finding: &Finding) -> &'static str {
    match finding.severity {
        Severity::Ok => "ok",
        Severity::Warning => "warning",
        Severity::Error => "ERROR",
    }
}

fn line(finding: &Finding) -> String {
    let cure = finding.cure.as_ref().map_or_else(String::new, |cure| format!("\n                   fix: {cure}"));
    format!("{:<7}  {:<8}  {}{cure}", severity_name(finding), finding.subject, finding.message)
}

fn to_json(finding: &Finding) -> serde_json::Value {
    let severity = severity_name(finding).to_lowercase();
    json!({ "severity": severity, "subject": finding.subject, "text": finding.message, "cure": finding.cure })
}
