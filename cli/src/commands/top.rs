//! `sdfarm top`: shows a farm live in the terminal.

use std::io::IsTerminal;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout};
use ratatui::style::{Color, Style, Stylize};
use ratatui::text::Line;
use ratatui::widgets::{Block, Borders, Cell, Gauge, Paragraph, Row, Sparkline, Table};

use crate::arguments::ServerArguments;
use crate::error::UsageError;
use crate::overview::{Overview, duration, fetch, scaled};
use crate::terminal::escape_line;

/// Number of speeds kept for the chart: the width of a wide terminal.
const HISTORY: usize = 400;
/// Interval between checks for keystrokes.
const KEYS_EVERY: Duration = Duration::from_millis(50);

/// Arguments of `top`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    server: ServerArguments,
    /// Refresh interval, in seconds.
    #[arg(long, value_name = "SECONDS", env = "SDFARM_EVERY", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=3600))]
    every: u64,
}

/// Content of the screen.
#[derive(Debug, Default)]
struct Screen {
    overview: Option<Overview>,
    failure: Option<String>,
    speeds: Vec<u64>,
}

impl Screen {
    fn show(&mut self, overview: Overview) {
        self.speeds.push(overview.queue.rays_per_second as u64);
        if self.speeds.len() > HISTORY {
            self.speeds.remove(0);
        }
        self.overview = Some(overview);
        self.failure = None;
    }
}

/// Shows it until q is pressed.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    if !std::io::stdout().is_terminal() {
        return Err(UsageError("top needs a terminal: use `sdfarm status`, with --json for programs".to_owned()).into());
    }
    let client = arguments.server.client()?;
    let mut screen = Screen::default();
    screen.show(fetch(&client).await?);
    let mut terminal = ratatui::try_init().context("could not switch the terminal to full screen")?;
    let done = async {
        let mut ticks = tokio::time::interval(Duration::from_secs(arguments.every));
        let mut keys = tokio::time::interval(KEYS_EVERY);
        loop {
            terminal.draw(|frame| draw(frame, &screen)).context("could not draw on the terminal")?;
            tokio::select! {
                _ = ticks.tick() => match fetch(&client).await {
                    Ok(overview) => screen.show(overview),
                    Err(error) => screen.failure = Some(error.to_string()),
                },
                _ = keys.tick() => if is_quit_requested()? {
                    return Ok(());
                },
            }
        }
    }
    .await;
    ratatui::restore();
    done
}

fn is_quit_requested() -> anyhow::Result<bool> {
    while event::poll(Duration::ZERO).context("could not read the keyboard")? {
        if let Event::Key(key) = event::read().context("could not read the keyboard")?
            && key.kind == KeyEventKind::Press
        {
            let is_interrupt = key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
            if is_interrupt || matches!(key.code, KeyCode::Char('q') | KeyCode::Esc) {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

fn draw(frame: &mut Frame<'_>, screen: &Screen) {
    let Some(overview) = &screen.overview else { return };
    let concerns = screen.failure.iter().chain(&overview.warnings).collect::<Vec<_>>();
    let rows = [
        Constraint::Length(4),
        Constraint::Length(3),
        Constraint::Min(4),
        Constraint::Min(4),
        Constraint::Length(concerns.len().clamp(1, 5) as u16 + 1),
    ];
    let [head, speed, jobs, workers, foot] = Layout::vertical(rows).areas(frame.area());
    frame.render_widget(Paragraph::new(header(overview)), head);
    let [graph, disk] = Layout::horizontal([Constraint::Percentage(60), Constraint::Percentage(40)]).areas(speed);
    let title = format!(" {}rays/s ", scaled(overview.queue.rays_per_second));
    frame.render_widget(Sparkline::default().data(&screen.speeds).block(titled(title)), graph);
    let used = 1.0 - overview.disk.free_bytes as f64 / (overview.disk.total_bytes as f64).max(1.0);
    let gauge = Gauge::default()
        .ratio(used.clamp(0.0, 1.0))
        .label(format!("{}B free", scaled(overview.disk.free_bytes as f64)));
    frame.render_widget(gauge.block(titled(" disk ".to_owned())), disk);
    frame.render_widget(job_table(overview), jobs);
    frame.render_widget(worker_table(overview), workers);
    frame.render_widget(Paragraph::new(alerts(&concerns)).block(titled(" alerts (q ends) ".to_owned())), foot);
}

fn titled(title: String) -> Block<'static> {
    Block::new().borders(Borders::TOP).title(title)
}

fn header(overview: &Overview) -> Vec<Line<'static>> {
    let queue = &overview.queue;
    let health = if overview.is_healthy() { overview.health.clone().green() } else { overview.health.clone().red() };
    let work = queue.work_seconds.map_or_else(|| "an unknown time".to_owned(), duration);
    let pool = overview.pool;
    let paused = if overview.paused { "  PAUSED".yellow() } else { "".into() };
    vec![
        Line::from(vec![
            format!("{}  ", overview.server).bold(),
            health,
            paused,
            format!("  sdfarm {}, up {}", overview.version, duration(overview.uptime_seconds)).into(),
        ]),
        format!(
            "jobs   {} running, {} queued; the oldest is {} old",
            queue.running,
            queue.queued,
            duration(queue.oldest_seconds)
        )
        .into(),
        format!("tiles  {} ready, {} leased; work for {work}", queue.tiles_ready, queue.tiles_leased).into(),
        format!(
            "pool   {} of {} ready; {} rate limited, {} fenced",
            pool.ready, pool.workers, overview.totals.rate_limited, overview.totals.fenced
        )
        .into(),
    ]
}

fn alerts(concerns: &[&String]) -> Vec<Line<'static>> {
    match concerns {
        [] => vec!["none".to_owned().green().into()],
        concerns => concerns.iter().map(|concern| Line::from(escape_line(concern).into_owned().yellow())).collect(),
    }
}

fn job_table(overview: &Overview) -> Table<'static> {
    let rows = overview.jobs.iter().map(|job| {
        let left = job.eta_seconds.map_or_else(|| "-".to_owned(), duration);
        let cells = [
            escape_line(&job.name).into_owned(),
            if job.paused { "paused" } else { job.state.name() }.to_owned(),
            format!("{:>3} %", (job.progress * 100.0).floor()),
            format!("{}/{}", job.tiles.done, job.tiles.total),
            format!("{}/{}", job.frames.done, job.frames.total),
            left,
        ];
        Row::new(cells.map(Cell::from))
    });
    let widths = [
        Constraint::Min(16),
        Constraint::Length(9),
        Constraint::Length(6),
        Constraint::Length(13),
        Constraint::Length(11),
        Constraint::Length(12),
    ];
    let header = Row::new(["job", "state", "done", "tiles", "frames", "left"]).style(Style::new().fg(Color::Cyan));
    Table::new(rows, widths)
        .header(header)
        .block(titled(format!(" {} unfinished jobs ", overview.queue.running + overview.queue.queued)))
}

fn worker_table(overview: &Overview) -> Table<'static> {
    let rows = overview.workers.iter().map(|worker| {
        let cells = [
            escape_line(&worker.name).into_owned(),
            escape_line(&worker.device).into_owned(),
            format!("{:?}", worker.state).to_lowercase(),
            worker.leases.to_string(),
            worker.rays_per_second.map_or_else(|| "-".to_owned(), |speed| format!("{}rays/s", scaled(speed))),
        ];
        Row::new(cells.map(Cell::from))
    });
    let widths = [
        Constraint::Min(16),
        Constraint::Length(8),
        Constraint::Length(11),
        Constraint::Length(6),
        Constraint::Length(14),
    ];
    let header = Row::new(["worker", "device", "state", "leases", "speed"]).style(Style::new().fg(Color::Cyan));
    Table::new(rows, widths).header(header).block(titled(format!(" {} workers ", overview.workers.len())))
}

#[cfg(test)]
mod tests {
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::*;

    fn shown(screen: &Screen, width: u16, height: u16) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a terminal");
        terminal.draw(|frame| draw(frame, screen)).expect("drawn");
        terminal.backend().to_string()
    }

    #[test]
    fn a_farm_is_readable_on_a_small_terminal() {
        let mut screen = Screen::default();
        screen.show(crate::overview::tests::unhealthy());
        let text = shown(&screen, 80, 24);
        for words in [
            "http://127.0.0.1:8080  ready  PAUSED  sdfarm 1.2.3, up 3 h 20 min",
            "1 running, 4 queued; the oldest is 2 h 1 min old",
            "90 ready, 8 leased; work for 1 h 1 min",
            "11.0 Mrays/s",
            "1.0 GB free",
            "fjord",
            "running    25 %",
            "paused     25 %",
            "1 min 15 s",
            "pool-1",
            "2.0 Mrays/s",
            "the farm is paused: `sdfarm resume` continues it",
            "q ends",
        ] {
            assert!(text.contains(words), "{words}:\n{text}");
        }
    }

    #[test]
    fn unreachable_server_is_reported_with_the_last_values() {
        let mut screen = Screen::default();
        screen.show(crate::overview::tests::unhealthy());
        screen.failure = Some("no server responds".to_owned());
        let text = shown(&screen, 80, 24);
        assert!(text.contains("no server responds") && text.contains("fjord"), "{text}");
    }

    #[test]
    fn every_terminal_size_can_be_drawn() {
        let mut screen = Screen::default();
        screen.show(crate::overview::tests::unhealthy());
        for (width, height) in [(1, 1), (20, 5), (300, 100)] {
            shown(&screen, width, height);
        }
    }
}
