//! `sdfarm tiles`: lists the tiles of a job, with the workers that rendered them.

use clap::Args;
use proto::tile_history::{TileLeaseView, TileView};

use crate::arguments::ServerArguments;
use crate::job_name::JobName;
use crate::terminal::{escape_line, print_line, print_note};

/// Arguments of `tiles`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    /// List only tiles of this frame.
    #[arg(long, value_name = "N", env = "SDFARM_FRAME")]
    frame: Option<u32>,
    /// Maximum number of tiles to list.
    #[arg(long, value_name = "N", env = "SDFARM_LIMIT", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=1000))]
    limit: u32,
    /// Continue an earlier list at the cursor that it printed.
    #[arg(long, env = "SDFARM_CURSOR")]
    cursor: Option<String>,
    #[command(flatten)]
    server: ServerArguments,
    /// Print the server's response as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Lists the tiles.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let job = arguments.id.find(&client).await?;
    let page = client.tiles(job, arguments.frame, arguments.limit, arguments.cursor.as_deref()).await?;
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&page)?);
    }
    for tile in &page.tiles {
        print_line(&line(tile))?;
    }
    if let Some(cursor) = page.next_cursor {
        let frame = arguments.frame.map_or_else(String::new, |frame| format!(" --frame {frame}"));
        print_note(&format!("more: sdfarm tiles {job}{frame} --cursor {cursor}"));
    }
    Ok(())
}

/// A tile as one line: the newest lease, and the number of all.
fn line(tile: &TileView) -> String {
    let place = format!("{},{} {}×{}", tile.x, tile.y, tile.width, tile.height);
    let state = format!("{:?}", tile.state).to_lowercase();
    let line = format!("frame {:<5} {place:<20} {state:<7}", tile.frame);
    let line = match tile.leases.last() {
        None => line,
        Some(lease) => format!("{line} {}", lease_text(lease)),
    };
    let line = if tile.attempts > 1 { format!("{line}  {} attempts", tile.attempts) } else { line };
    line.trim_end().to_owned()
}

fn lease_text(lease: &TileLeaseView) -> String {
    let outcome =
        lease.outcome.map_or_else(|| "renders it".to_owned(), |outcome| format!("{outcome:?}").to_lowercase());
    let seconds = lease.seconds.map_or_else(String::new, |seconds| format!(" in {seconds:.3} s"));
    let (name, device) = (escape_line(&lease.worker_name), escape_line(&lease.device));
    format!("{outcome}{seconds}  {name} ({}) on {device}, {}", lease.worker.short(), lease.started_at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tile_is_one_line() {
        let text = r#"{"frame": 2, "x": 256, "y": 0, "width": 256, "height": 64, "state": "done", "attempts": 2, "leases": [
            {"worker": "01890a5d-ac96-774b-bcce-b302099a8057", "worker_name": "pool-1", "device": "cpu",
             "started_at": "2026-01-01T00:00:00.000Z", "ended_at": "2026-01-01T00:00:01.000Z", "outcome": "done",
             "seconds": 0.25}]}"#;
        let mut tile: TileView = serde_json::from_str(text).expect("a tile");
        assert_eq!(
            line(&tile),
            "frame 2     256,0 256×64         done    done in 0.250 s  pool-1 (099a8057) on cpu, \
             2026-01-01T00:00:00.000Z  2 attempts"
        );
        (tile.leases, tile.attempts) = (Vec::new(), 0);
        assert_eq!(line(&tile), "frame 2     256,0 256×64         done");
    }
}
