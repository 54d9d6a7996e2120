//! `sdfarm status`: shows the state of a farm on one screen.

use clap::Args;
use clap::builder::FalseyValueParser;

use crate::arguments::ServerArguments;
use crate::counted::{counted, counted_len};
use crate::overview::{Overview, duration, fetch, scaled};
use crate::terminal::{escape_line, print_line};

/// Maximum number of jobs, and of workers, to list.
const LISTED: usize = 8;

/// Arguments of `status`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    server: ServerArguments,
    /// Print the state as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
    /// Check only that the database and the store are usable, which needs no key: for health checks.
    #[arg(long, env = "SDFARM_READY", value_parser = FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    ready: bool,
}

/// Prints the state; an unhealthy farm is an error.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    if arguments.ready {
        return print_line(&client.ready().await?.status);
    }
    let overview = fetch(&client).await?;
    if arguments.json {
        print_line(&serde_json::to_string_pretty(&overview)?)?;
    } else {
        print_line(&lines(&overview).join("\n"))?;
    }
    anyhow::ensure!(overview.is_healthy(), "the farm is unhealthy: {}", overview.health);
    Ok(())
}

/// Formats the screen's lines.
fn lines(overview: &Overview) -> Vec<String> {
    let Overview { queue, pool, scaling, disk, .. } = overview;
    let work = queue.work_seconds.map_or_else(|| "an unknown time".to_owned(), duration);
    let (version, uptime) = (&overview.version, duration(overview.uptime_seconds));
    let paused = if overview.paused { ", paused" } else { "" };
    let mut lines = vec![
        format!("{}  {}{paused}, sdfarm {version}, up {uptime}", overview.server, overview.health),
        format!(
            "queue    {} running, {} queued, {} ready, {} leased; work for {work}, the oldest is {} old",
            queue.running,
            queue.queued,
            counted(queue.tiles_ready, "tile"),
            queue.tiles_leased,
            duration(queue.oldest_seconds)
        ),
        format!(
            "pool     {} of {} ready; all workers: {}rays/s",
            pool.ready,
            pool.workers,
            scaled(queue.rays_per_second)
        ),
        format!(
            "wanted   {} on CPUs, {} on GPUs, to finish within {}",
            counted(scaling.cpu.wanted_workers, "worker"),
            scaling.cuda.wanted_workers,
            duration(f64::from(scaling.target_seconds))
        ),
        format!(
            "disk     {}B free of {}B; pictures and tiles {}B, database {}B",
            scaled(disk.free_bytes as f64),
            scaled(disk.total_bytes as f64),
            scaled(disk.store_bytes as f64),
            scaled(disk.database_bytes as f64)
        ),
    ];
    for worker in overview.workers.iter().take(LISTED) {
        let speed = worker.rays_per_second.map_or_else(|| "-".to_owned(), |speed| format!("{}rays/s", scaled(speed)));
        let state = format!("{:?}", worker.state).to_lowercase();
        lines.push(format!(
            "worker   {:<20} {:<8} {state:<11} {:>10}  {speed}",
            escape_line(&worker.name),
            escape_line(&worker.device),
            counted(worker.leases, "lease")
        ));
    }
    for job in overview.jobs.iter().take(LISTED) {
        let left = job.eta_seconds.map_or_else(String::new, |seconds| format!("  {} left", duration(seconds)));
        let percent = (job.progress * 100.0).floor();
        let paused = if job.paused { "  paused" } else { "" };
        lines.push(format!(
            "job      {}  {:<8} {percent:>3} %{paused}{left}  {}",
            job.id.short(),
            job.state.name(),
            escape_line(&job.name)
        ));
    }
    for (noun, all) in [("more worker", overview.workers.len()), ("more unfinished job", overview.jobs.len())] {
        if all > LISTED {
            lines.push(format!("         and {}", counted_len(all - LISTED, noun)));
        }
    }
    match &overview.warnings[..] {
        [] => lines.push("alerts   none".to_owned()),
        concerns => lines.extend(concerns.iter().map(|concern| format!("alert    {}", escape_line(concern)))),
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_farm_fits_on_a_screen() {
        let text = lines(&crate::overview::tests::unhealthy()).join("\n");
        let wanted = "\
http://127.0.0.1:8080  ready, paused, sdfarm 1.2.3, up 3 h 20 min
queue    1 running, 4 queued, 90 tiles ready, 8 leased; work for 1 h 1 min, the oldest is 2 h 1 min old
pool     1 of 2 ready; all workers: 11.0 Mrays/s
wanted   4 workers on CPUs, 1 on GPUs, to finish within 10 min 0 s
disk     1.0 GB free of 9.0 GB; pictures and tiles 570 B, database 0 B
worker   pool-1               cpu      ready         8 leases  2.0 Mrays/s
job      099a8058  running   25 %  1 min 15 s left  fjord
job      099a8058  running   25 %  paused  lantern
alert    the farm is paused: `sdfarm resume` continues it
alert    3 leases expired
alert    1 request failed in the server";
        assert_eq!(text, wanted);
    }
}
