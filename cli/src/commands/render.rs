//! `sdfarm render`: renders one picture, or some frames of an animation, on this machine, without a server.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use anyhow::Context;
use clap::Args;
use proto::rounding;
use scene::{Format, Job};
use serde::Serialize;
use tokio::runtime::Runtime;
use worker::frame::{FrameTimes, render_frame};
use worker::{CancelFlag, Renderer};

use crate::arguments::RendererArguments;
use crate::counted::{counted, counted_len};
use crate::error::UsageError;
use crate::frame_list::FrameList;
use crate::job_file::JobFile;
use crate::output_file::{OutputFile, check_format, format_of, is_folder, make_folder};
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
    /// File for the picture: .png or .exr decides the format; - for standard output, in the job's format. With --frames,
    /// a folder (`DIR/`) or a pattern such as shot.####.png.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT")]
    output: String,
    /// Frame number, from 0.
    #[arg(long, value_name = "N", env = "SDFARM_FRAME", default_value_t = 0)]
    frame: u32,
    /// Frames of an animation: a number, a range, or several, as in 0-11 or 0,4,8-11.
    #[arg(long, value_name = "LIST", env = "SDFARM_FRAMES", conflicts_with = "frame")]
    frames: Option<FrameList>,
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

/// Renders the pictures.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let file = arguments.overrides.apply(JobFile::read(&arguments.job)?)?;
    let mut job = file.parse()?;
    if (arguments.frames.is_none() || !is_folder(&arguments.output))
        && let Some(format) = format_of(&arguments.output)?
    {
        job.image.format = format;
        if format == Format::Png && !job.image.layers.is_empty() {
            print_note(&format!("{}: warning: the layers are left out: write to an .exr file to have them", file.name));
            job.image.layers.clear();
        }
    }
    check_format(&job)?;
    let files = match &arguments.frames {
        Some(list) => list.files(&job, &arguments.output)?,
        None => vec![(arguments.frame, arguments.output.clone())],
    };
    for (frame, _) in &files {
        check_frame(&job, *frame)?;
    }
    if arguments.frames.is_some() && is_folder(&arguments.output) {
        make_folder(&arguments.output)?;
    }
    let warnings = scene::warnings(&job);
    if !arguments.json {
        for warning in &warnings {
            print_note(&format!("{}: warning: {}", file.name, escape_line(warning)));
        }
    }
    let renderer = arguments.renderer.renderer()?;
    let cancel = CancelFlag::new();
    let stopper = Stopper::start(&cancel)?;
    let silent = Progress::silent;
    let progress =
        if arguments.json { silent() } else { Progress::new(&job.name, job.rays_per_frame() * files.len() as u64) };
    let setting = Setting { renderer: &*renderer, job: &job, arguments, cancel: &cancel, progress: &progress };
    for (index, (frame, path)) in files.iter().enumerate() {
        let mut output = OutputFile::create(path)?;
        stopper.remove_on_signal(Some(output.temporary_path()));
        let times = setting.render(*frame, path, &mut output);
        if times.is_err() || index + 1 == files.len() {
            progress.finish();
        }
        if cancel.is_cancelled() {
            progress.finish();
            let written = if index == 0 { "nothing".to_owned() } else { counted_len(index, "picture") };
            anyhow::bail!("interrupted: {written} {} written", if index > 1 { "were" } else { "was" });
        }
        let times = times?;
        // From here on the file is complete, and is not deleted any more.
        stopper.remove_on_signal(None);
        output.commit()?;
        let summary = Summary {
            output: path,
            frame: *frame,
            width: job.image.film().width,
            height: job.image.film().height,
            samples: job.image.samples.max(),
            device: renderer.device(),
            render_ms: rounding::seconds(times.render.as_secs_f64() * 1e3),
            encode_ms: rounding::seconds(times.encode.as_secs_f64() * 1e3),
            warnings: warnings.clone(),
        };
        summary.print(arguments.json)?;
    }
    if let (count @ 2.., frame, false, None) = (job.frames.count, arguments.frame, arguments.json, &arguments.frames) {
        print_note(&format!(
            "this is frame {frame} of {count}: --frame or --frames 0-{} selects others, `sdfarm submit` renders all",
            count - 1
        ));
    }
    Ok(())
}

impl Summary<'_> {
    fn print(&self, is_json: bool) -> anyhow::Result<()> {
        if !is_json {
            print_note(&self.words());
            return Ok(());
        }
        let line = serde_json::to_string(self)?;
        // If the picture goes to standard output, nothing else may.
        if self.output == "-" {
            print_note(&line);
            return Ok(());
        }
        print_line(&line)
    }

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

/// Everything that the frames of a render share.
struct Setting<'a> {
    renderer: &'a dyn Renderer,
    job: &'a Job,
    arguments: &'a Arguments,
    cancel: &'a CancelFlag,
    progress: &'a Progress,
}

impl Setting<'_> {
    fn render(&self, frame: u32, path: &str, output: &mut OutputFile) -> anyhow::Result<FrameTimes> {
        let Self { renderer, job, arguments, cancel, progress } = self;
        // A large frame uses an unnamed temporary file in the picture's folder, which needs that space anyway.
        let scratch = output.folder().to_owned();
        let context = || format!("could not render {} to {path}", arguments.job);
        let mut writer = BufWriter::new(output.file());
        let times = render_frame(*renderer, job, frame, arguments.tile, &scratch, &mut writer, cancel, &|rays| {
            progress.add(rays);
        })
        .with_context(context)?;
        writer.flush().with_context(context)?;
        Ok(times)
    }
}

/// Rejects a frame number that the job does not have.
pub(crate) fn check_frame(job: &Job, frame: u32) -> anyhow::Result<()> {
    let count = job.frames.count;
    if frame < count {
        return Ok(());
    }
    Err(UsageError(format!("there is no frame {frame}: {} has frames 0 to {}", job.name, count - 1)).into())
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
