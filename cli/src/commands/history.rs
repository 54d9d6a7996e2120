//! `sdfarm history`: the farm's throughput of the last hour, day or week as a table.

use clap::{Args, ValueEnum};
use proto::history::{HistoryPoint, HistoryView};

use crate::arguments::ServerArguments;
use crate::overview::scaled;
use crate::terminal::print_line;

/// Arguments of `history`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Time to show: the last hour in steps of 5 min, the last day by hours, or the last week in steps of 6 h.
    #[arg(long, value_name = "TIME", env = "SDFARM_LAST", value_enum, default_value = "hour")]
    last: Span,
    #[command(flatten)]
    server: ServerArguments,
    /// Print the server's response as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Span {
    Hour,
    Day,
    Week,
}

impl Span {
    /// Its seconds, and the number of steps.
    fn steps(self) -> (u32, u32) {
        match self {
            Self::Hour => (3600, 12),
            Self::Day => (86_400, 24),
            Self::Week => (7 * 86_400, 28),
        }
    }
}

/// Prints the table.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let (seconds, points) = arguments.last.steps();
    let history = arguments.server.client()?.history(seconds, points).await?;
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&history)?);
    }
    print_line(&table(&history).join("\n"))
}

fn table(history: &HistoryView) -> Vec<String> {
    let mut lines = vec![format!(
        "{:<20} {:>10} {:>8} {:>8} {:>8} {:>6} {:>10}",
        "from", "rays", "tiles", "frames", "workers", "busy", "waiting"
    )];
    lines.extend(history.points.iter().map(line));
    lines
}

fn line(point: &HistoryPoint) -> String {
    let HistoryPoint { at, rays, tiles, frames, workers, busy, queued_tiles, .. } = point;
    let at = at.split_once('.').map_or(at.as_str(), |(seconds, _)| seconds).replace('T', " ");
    let rays = scaled(*rays as f64);
    format!(
        "{at:<20} {:>10} {tiles:>8} {frames:>8} {workers:>8.1} {:>4.0} % {:>10}",
        rays.trim_end(),
        busy * 100.0,
        scaled(*queued_tiles).trim_end()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn throughput_is_a_table() {
        let point = HistoryPoint {
            at: "2026-01-01T12:00:00.000Z".to_owned(),
            rays: 2_500_000,
            tiles: 40,
            frames: 2,
            workers: 1.5,
            busy: 0.75,
            queued_tiles: 12_000.0,
            jobs_queued: 3.0,
            jobs_running: 1.0,
        };
        let lines = table(&HistoryView { step_seconds: 300, points: vec![point] });
        let wanted = [
            "from                       rays    tiles   frames  workers   busy    waiting",
            "2026-01-01 12:00:00       2.5 M       40        2      1.5   75 %     12.0 k",
        ];
        assert_eq!(lines, wanted);
    }
}
