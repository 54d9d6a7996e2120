//! `sdfarm render`: renders one picture on this machine, without a server.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use anyhow::Context;
use clap::Args;
use proto::rounding;
use scene::Job;
use serde::Serialize;
use tokio::runtime::Runtime;
use worker::frame::{FrameTimes, render_frame};
use worker::{CancelFlag, Renderer};

use crate::arguments::RendererArguments;
use crate::counted::counted;
use crate::error::UsageError;
use crate::job_file::JobFile;
use crate::output_file::{OutputFile, check_format, format_of};
use crate::overrides::OverrideArguments;
use crate::progress::Progress;
use crate::signals::Signals;
use crate::terminal::{escape_line, print_line, print_note};

/// Arguments of `render`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job file; - for standard input.
    job: String,
    #[command(flatten)]
    overrides: OverrideArguments,
    /// File for the picture: .png or .exr decides the format; - for standard output, in the job's format.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT")]
    output: String,
    /// Frame number, from 0.
    #[arg(long, value_name = "N", env = "SDFARM_FRAME", default_value_t = 0)]
    frame: u32,
    #[command(flatten)]
    renderer: RendererArguments,
    /// Edge of the rendered tiles, in pixels; every choice gives the same picture.
    #[arg(long, value_name = "PIXELS", env = "SDFARM_TILE", value_parser = clap::value_parser!(u32).range(1..))]
    tile: Option<u32>,
    /// Print the summary as JSON, and no progress; to standard error if the picture goes to standard output.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Summary of a render, for users and for programs.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    output: &'a str,
    frame: u32,
    width: u32,
    height: u32,
    samples: u32,
    device: String,
    render_ms: f64,
    encode_ms: f64,
    warnings: Vec<String>,
}

/// Renders the picture.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let file = arguments.overrides.apply(JobFile::read(&arguments.job)?)?;
    let mut job = file.parse()?;
    if let Some(format) = format_of(&arguments.output)? {
        job.image.format = format;
    }
    check_format(&job)?;
    check_frame(&job, arguments.frame)?;
    let warnings = job.warnings();
    if !arguments.json {
        for warning in &warnings {
            print_note(&format!("{}: warning: {}", file.name, escape_line(warning)));
        }
    }
    let renderer = arguments.renderer.renderer()?;
    let cancel = CancelFlag::new();
    let stopper = Stopper::start(&cancel)?;
    let mut output = OutputFile::create(&arguments.output)?;
    stopper.remove_on_signal(Some(output.temporary_path()));
    let progress = if arguments.json { Progress::silent() } else { Progress::new(&job.name, rays(&job)) };

    let times = render(&*renderer, &job, arguments, &mut output, &cancel, &progress);
    progress.finish();
    if cancel.is_cancelled() {
        anyhow::bail!("interrupted: nothing was written");
    }
    let times = times?;
    // From here on the file is complete, and is not deleted any more.
    stopper.remove_on_signal(None);
    output.commit()?;

    let summary = Summary {
        output: &arguments.output,
        frame: arguments.frame,
        width: job.image.width,
        height: job.image.height,
        samples: job.image.samples,
        device: renderer.device(),
        render_ms: rounding::seconds(times.render.as_secs_f64() * 1e3),
        encode_ms: rounding::seconds(times.encode.as_secs_f64() * 1e3),
        warnings,
    };
    if arguments.json {
        let line = serde_json::to_string(&summary)?;
        // If the picture goes to standard output, nothing else may.
        if arguments.output == "-" { print_note(&line) } else { print_line(&line)? }
    } else {
        print_note(&summary.words());
        if let (count @ 2.., frame) = (job.frames.count, arguments.frame) {
            print_note(&format!(
                "this is frame {frame} of {count}: --frame selects another, `sdfarm submit` renders all"
            ));
        }
    }
    Ok(())
}

impl Summary<'_> {
    fn words(&self) -> String {
        let Self { output, width, height, samples, device, render_ms, encode_ms, .. } = self;
        let output = if *output == "-" { "standard output" } else { output };
        format!(
            "wrote {output}: {width}×{height}, {}, on {device}: rendered in {}, encoded in {}",
            counted(*samples, "sample"),
            took(*render_ms),
            took(*encode_ms)
        )
    }
}

/// Formats a measured time: in milliseconds below 1 s, otherwise in seconds.
fn took(ms: f64) -> String {
    if ms < 1000.0 { format!("{ms:.1} ms") } else { format!("{:.2} s", ms / 1000.0) }
}

fn render(
    renderer: &dyn Renderer,
    job: &Job,
    arguments: &Arguments,
    output: &mut OutputFile,
    cancel: &CancelFlag,
    progress: &Progress,
) -> anyhow::Result<FrameTimes> {
    // A large frame uses an unnamed temporary file in the picture's folder, which needs that space anyway.
    let scratch = output.folder().to_owned();
    let context = || format!("could not render {} to {}", arguments.job, arguments.output);
    let mut writer = BufWriter::new(output.file());
    let times = render_frame(renderer, job, arguments.frame, arguments.tile, &scratch, &mut writer, cancel, &|rays| {
        progress.add(rays);
    })
    .with_context(context)?;
    writer.flush().with_context(context)?;
    Ok(times)
}

/// Rejects a frame number that the job does not have.
pub(crate) fn check_frame(job: &Job, frame: u32) -> anyhow::Result<()> {
    let count = job.frames.count;
    if frame < count {
        return Ok(());
    }
    Err(UsageError(format!("there is no frame {frame}: {} has frames 0 to {}", job.name, count - 1)).into())
}

fn rays(job: &Job) -> u64 {
    u64::from(job.image.width) * u64::from(job.image.height) * u64::from(job.image.samples)
}

/// Makes the first signal a cancel, and the second one delete the temporary file and end the process.
struct Stopper {
    temporary: Arc<Mutex<Option<PathBuf>>>,
    _runtime: Runtime,
}

impl Stopper {
    fn start(cancel: &CancelFlag) -> anyhow::Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .context("could not start the thread that waits for signals")?;
        let temporary = Arc::new(Mutex::new(None::<PathBuf>));
        let (cancel, in_haste) = (cancel.clone(), Arc::clone(&temporary));
        let entered = runtime.enter();
        let mut signals = Signals::install()?;
        drop(entered);
        runtime.spawn(async move {
            signals.next().await;
            cancel.cancel();
            signals.next().await;
            if let Some(path) = in_haste.lock().ok().and_then(|mut path| path.take()) {
                // The file may already be deleted.
                let _ = std::fs::remove_file(path);
            }
            std::process::exit(1);
        });
        Ok(Self { temporary, _runtime: runtime })
    }

    fn remove_on_signal(&self, path: Option<&Path>) {
        if let Ok(mut temporary) = self.temporary.lock() {
            *temporary = path.map(Path::to_owned);
        }
    }
}
