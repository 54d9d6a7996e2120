//! `sdfarm selftest`: whether this machine renders the right bits, at every SIMD level it has.

use std::time::Instant;

use anyhow::Context;
use clap::Args;
use proto::Rect;
use scene::{Image, Job, Layer};
use worker::{Cancel, CpuRenderer, Pixels, RenderError, Renderer, Simd, TileRun};

use crate::arguments::Device;
use crate::shipped;
use crate::terminal::say;

const SCENES: [&str; 3] = ["csg", "five-spheres", "mandelbulb"];
const LEVELS: [Simd; 4] = [Simd::Scalar, Simd::Sse42, Simd::Avx2, Simd::Avx512];
const WIDTH_PX: u32 = 96;
const SAMPLES: u32 = 2;

/// Arguments of `selftest`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// What to test.
    #[arg(long, env = "SDFARM_DEVICE", default_value = "cpu")]
    device: Device,
}

/// Renders small pictures at every level and compares them with the scalar one, bit by bit.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.device.check()?;
    let mut wrong = 0;
    say(&format!("{:<14} {:<8} {:>9}  bits", "scene", "level", "ms"))?;
    for name in SCENES {
        let job = small(scene::parse(&shipped::job_file(name)?).context("a shipped scene is damaged")?);
        let mut reference: Option<Pixels> = None;
        for level in LEVELS {
            let (verdict, ms) = match render(&job, level) {
                Ok((pixels, ms)) => {
                    let differing = reference.as_ref().map_or(0, |reference| differing(reference, &pixels));
                    wrong += differing;
                    reference.get_or_insert(pixels);
                    (if differing == 0 { "equal".to_owned() } else { format!("{differing} values differ") }, ms)
                }
                Err(RenderError::Unavailable { .. }) => ("not on this machine".to_owned(), 0.0),
                Err(other) => return Err(other.into()),
            };
            say(&format!("{name:<14} {:<8} {ms:>9.1}  {verdict}", level.to_string()))?;
        }
    }
    anyhow::ensure!(wrong == 0, "this machine does not render the right bits: let it render for no farm");
    Ok(())
}

/// The job in a size that takes a moment, with every layer.
fn small(job: Job) -> Job {
    let height = (job.image.height * WIDTH_PX / job.image.width).max(1);
    let layers = vec![Layer::Depth, Layer::Normal, Layer::Position, Layer::Albedo, Layer::Object, Layer::Steps];
    Job { image: Image { width: WIDTH_PX, height, samples: SAMPLES, layers, ..job.image }, ..job }
}

fn render(job: &Job, level: Simd) -> Result<(Pixels, f64), RenderError> {
    let renderer = CpuRenderer::new(None, level)?;
    let run = TileRun { job, frame: 0, rect: Rect::whole(job.image.width, job.image.height) };
    let start = Instant::now();
    let pixels = renderer.render(&run, &Cancel::new(), &|_| {})?;
    Ok((pixels, start.elapsed().as_secs_f64() * 1e3))
}

fn differing(want: &Pixels, got: &Pixels) -> usize {
    let bits = |pixels: &Pixels| pixels.planes.iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>();
    bits(want).iter().zip(bits(got)).filter(|(want, got)| **want != *got).count()
}
