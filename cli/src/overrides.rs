//! Values that a command sets in a job: `--set`, `--samples`, `--region`, `--scale`.

use clap::Args;
use scene::Layer;
use scene::limits::MIN_REWEIGHTED_SAMPLES;

use crate::error::UsageError;
use crate::job_file::JobFile;
use crate::terminal::print_note;

/// Values of a job that are replaced for one command.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct OverrideArguments {
    /// Sets a value of the job, as in numbers.r=0.3 or scene.camera.fov=30; may be repeated.
    #[arg(long, value_name = "PATH=VALUE", env = "SDFARM_SET", value_parser = assignment)]
    set: Vec<(String, String)>,
    /// Sets the rays per pixel.
    #[arg(long, value_name = "N", env = "SDFARM_SAMPLES", value_parser = clap::value_parser!(u32).range(1..=i64::from(scene::limits::MAX_SAMPLES)))]
    samples: Option<u32>,
    /// Renders only a part of the picture: its left column, top row, width and height in pixels.
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", env = "SDFARM_REGION", value_parser = region)]
    region: Option<String>,
    /// Scales the picture's width and height, as in 25%.
    #[arg(long, value_name = "PERCENT", env = "SDFARM_SCALE", value_parser = percentage)]
    scale: Option<f64>,
}

impl OverrideArguments {
    /// The job file with these values.
    pub(crate) fn apply(&self, file: JobFile) -> anyhow::Result<JobFile> {
        let Self { set, samples, region, scale } = self;
        if set.is_empty() && samples.is_none() && region.is_none() && scale.is_none() {
            return Ok(file);
        }
        let JobFile { name, text } = file;
        let mut text = String::from_utf8(text).map_err(|_| UsageError(format!("{name} is not UTF-8")))?;
        for (path, value) in set {
            text = replaced(&text, path, value)?;
        }
        if let Some(samples) = samples {
            text = with_samples(&name, &text, *samples)?;
        }
        if let Some(region) = region {
            text = replaced(&text, "image.region", region)?;
        }
        if let Some(scale) = scale {
            let image = JobFile { name: name.clone(), text: text.clone().into_bytes() }.parse()?.image;
            let [width, height] = [image.width, image.height].map(|edge| (f64::from(edge) * scale).round().max(1.0));
            for (path, edge) in [("image.width", width), ("image.height", height)] {
                text = replaced(&text, path, &edge.to_string())?;
            }
            if let Some(region) = image.region {
                text = replaced(&text, "image.region", &scaled_region(region, *scale, [width, height]))?;
            }
        }
        Ok(JobFile { name, text: text.into_bytes() })
    }
}

/// A job with this number of samples, without what needs more of them: any job can be rendered with one.
fn with_samples(name: &str, text: &str, samples: u32) -> anyhow::Result<String> {
    let mut changed = replaced(text, "image.samples", &samples.to_string())?;
    // An invalid job is reported as a whole, later.
    let Ok(job) = scene::parse(text.as_bytes()) else { return Ok(changed) };
    let mut leave_out = |path: &str, value: &str| {
        let least = if path == "image.denoise" { 2 } else { MIN_REWEIGHTED_SAMPLES };
        print_note(&format!("{name}: warning: {path} is left out: it needs {least} samples or more"));
        changed = replaced(&changed, path, value)?;
        anyhow::Ok(())
    };
    let image = &job.image;
    let (loses_denoise, loses_reweighting) =
        (image.denoise && samples < 2, image.reweight_fireflies && samples < MIN_REWEIGHTED_SAMPLES);
    if loses_denoise {
        leave_out("image.denoise", "false")?;
    }
    if loses_reweighting {
        leave_out("image.reweight_fireflies", "false")?;
    }
    let has_noise_removed = (image.denoise && !loses_denoise) || (image.reweight_fireflies && !loses_reweighting);
    if !has_noise_removed && image.layers.contains(&Layer::Noisy) {
        let layers: Vec<&Layer> = image.layers.iter().filter(|layer| **layer != Layer::Noisy).collect();
        print_note(&format!("{name}: warning: the layer noisy is left out: the picture is not denoised"));
        changed = replaced(&changed, "image.layers", &serde_json::to_string(&layers)?)?;
    }
    Ok(changed)
}

fn replaced(text: &str, path: &str, value: &str) -> anyhow::Result<String> {
    scene::set_value(text, path, value).map_err(|message| UsageError(format!("could not set {path}: {message}")).into())
}

fn assignment(text: &str) -> Result<(String, String), String> {
    let (path, value) = text.split_once('=').ok_or("write PATH=VALUE, as in numbers.r=0.3")?;
    Ok((path.trim().to_owned(), value.trim().to_owned()))
}

/// A region of a picture that is scaled to this width and height.
fn scaled_region(region: scene::Region, scale: f64, [full_width, full_height]: [f64; 2]) -> String {
    let axis = |start: u32, length: u32, full: f64| {
        let start = (f64::from(start) * scale).floor().min(full - 1.0);
        (start, (f64::from(length) * scale).round().clamp(1.0, full - start))
    };
    let (x, width) = axis(region.x, region.width, full_width);
    let (y, height) = axis(region.y, region.height, full_height);
    format!("[{x}, {y}, {width}, {height}]")
}

/// Four whole numbers as a JSON list.
fn region(text: &str) -> Result<String, String> {
    let list = text.trim().trim_start_matches('[').trim_end_matches(']');
    let numbers: Vec<u32> = list.split(',').filter_map(|number| number.trim().parse().ok()).collect();
    if numbers.len() != 4 || list.split(',').count() != 4 {
        return Err("write X,Y,WIDTH,HEIGHT in pixels, as in 640,360,320,180".to_owned());
    }
    Ok(format!("{numbers:?}"))
}

fn percentage(text: &str) -> Result<f64, String> {
    let percent = text.strip_suffix('%').unwrap_or(text).trim().parse::<f64>();
    let percent = percent.ok().filter(|percent| (0.01..=10_000.0).contains(percent));
    percent
        .map(|percent| percent / 100.0)
        .ok_or_else(|| "write a percentage from 0.01% to 10000%, as in 25%".to_owned())
}
