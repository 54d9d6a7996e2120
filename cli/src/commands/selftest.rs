//! `sdfarm selftest`: checks that this machine renders bit-identical pictures.

mod startup;

use std::time::Instant;

use anyhow::Context;
use clap::{Args, ValueEnum};
use proto::tile::Tiling;
use scene::{ImageSpec, Job, Layer};
use worker::{CancelFlag, CpuRenderer, RenderError, Renderer, Simd, TilePixels, TileRequest};

use crate::arguments::{DeviceChoice, RendererArguments};
use crate::shipped;
use crate::terminal::print_line;

pub(crate) use startup::check;

const LEVELS: [Simd; 4] = [Simd::Scalar, Simd::Portable, Simd::Avx2, Simd::Avx512];
const LAYERS: [Layer; 6] = [Layer::Depth, Layer::Normal, Layer::Position, Layer::Albedo, Layer::Object, Layer::Steps];

/// Arguments of `selftest`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Names of shipped scenes [default: all; three of them for --against levels].
    #[arg(value_name = "SCENE")]
    scenes: Vec<String>,
    /// Reference to compare with [default: levels on a CPU, hashes on a GPU].
    #[arg(long, env = "SDFARM_AGAINST")]
    against: Option<Reference>,
    /// Edge of the rendered tiles, in pixels [default: a server's choice].
    #[arg(long, value_name = "PIXELS", env = "SDFARM_TILE", value_parser = clap::value_parser!(u32).range(1..))]
    tile: Option<u32>,
    /// Print the hashes of the pixels in the format of scenes/hashes.txt instead of comparing them.
    #[arg(long, hide = true)]
    print: bool,
    #[command(flatten)]
    renderer: RendererArguments,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Reference {
    /// Small pictures, rendered at every SIMD level that this CPU has.
    Levels,
    /// Full-size pictures, by the hashes built into this program.
    Hashes,
    /// Full-size pictures, rendered by this machine's CPU.
    Cpu,
}

/// Renders shipped scenes and compares every bit.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let against = arguments.against.unwrap_or(match arguments.renderer.device {
        DeviceChoice::Cpu | DeviceChoice::Auto(_) => Reference::Levels,
        DeviceChoice::Cuda(_) => Reference::Hashes,
    });
    let differing = match against {
        Reference::Levels if !arguments.print => compare_levels(arguments)?,
        _ => compare_full_size(arguments, against)?,
    };
    anyhow::ensure!(differing == 0, "this machine does not render bit-identical pictures: do not use it in a farm");
    Ok(())
}

/// Renders full-size pictures; returns how many of them differ.
fn compare_full_size(arguments: &Arguments, against: Reference) -> anyhow::Result<usize> {
    let renderer = arguments.renderer.renderer()?;
    let cpu = CpuRenderer::new(None, Simd::Auto)?;
    let all = shipped::names();
    let names = if arguments.scenes.is_empty() { &all } else { &arguments.scenes };
    let mut differing = 0;
    for name in names {
        let job = with_layers(job(name)?, None);
        let start = Instant::now();
        let tiles = render(&*renderer, &job, arguments.tile)?;
        let ms = start.elapsed().as_secs_f64() * 1e3;
        if arguments.print {
            print_line(&format!("{} {name}", hash(&job, &tiles)))?;
            continue;
        }
        let (bytes, wrong) = match against {
            Reference::Cpu => compared(&tiles, &render(&cpu, &job, arguments.tile)?),
            Reference::Hashes | Reference::Levels => {
                let film = job.image.film();
                let bytes = film.pixels() * u64::from(film.pixel_bytes());
                (bytes, u64::from(shipped::hash(name).as_deref() != Some(hash(&job, &tiles).as_str())) * bytes)
            }
        };
        differing += usize::from(wrong != 0);
        let verdict = match (wrong, against) {
            (0, _) => "equal".to_owned(),
            (_, Reference::Cpu) => format!("{wrong} BYTES DIFFER"),
            (_, Reference::Hashes | Reference::Levels) => "DIFFERENT".to_owned(),
        };
        let device = renderer.device();
        print_line(&format!("{name:<22} {device:<8} {ms:>9.1} ms {:>8.1} MB  {verdict}", bytes as f64 / 1e6))?;
    }
    Ok(differing)
}

/// Renders small pictures at every level and compares them with the scalar one; returns how many values differ.
fn compare_levels(arguments: &Arguments) -> anyhow::Result<usize> {
    let few = ["csg", "five-spheres", "mandelbulb"].map(str::to_owned);
    let names = if arguments.scenes.is_empty() { few.as_slice() } else { &arguments.scenes };
    let mut wrong = 0;
    print_line(&format!("{:<22} {:<8} {:>9}  bits", "scene", "level", "ms"))?;
    for name in names {
        let job = with_layers(job(name)?, Some(96));
        let mut reference: Option<Vec<TilePixels>> = None;
        for level in LEVELS {
            let start = Instant::now();
            let rendered = CpuRenderer::new(None, level).and_then(|renderer| render(&renderer, &job, None));
            let ms = start.elapsed().as_secs_f64() * 1e3;
            let verdict = match rendered {
                Ok(tiles) => {
                    let (_, differing) = reference.as_ref().map_or((0, 0), |reference| compared(&tiles, reference));
                    wrong += differing as usize;
                    reference.get_or_insert(tiles);
                    if differing == 0 { "equal".to_owned() } else { format!("{differing} bytes differ") }
                }
                Err(RenderError::Unavailable { .. }) => "not on this machine".to_owned(),
                Err(other) => return Err(other.into()),
            };
            print_line(&format!("{name:<22} {:<8} {ms:>9.1}  {verdict}", level.to_string()))?;
        }
    }
    Ok(wrong)
}

fn job(name: &str) -> anyhow::Result<Job> {
    scene::parse(&shipped::job_file(name)?).context("a shipped scene is damaged")
}

/// The job with more layers; scaled to this width, if given, so that it renders quickly.
fn with_layers(mut job: Job, width: Option<u32>) -> Job {
    let own = std::mem::replace(&mut job.image.layers, LAYERS.to_vec());
    job.image.layers.extend(own.into_iter().filter(|layer| !LAYERS.contains(layer)));
    if let Some(width) = width {
        let height = (job.image.height * width / job.image.width).max(1);
        job.image = ImageSpec { width, height, samples: 2.into(), ..job.image };
    }
    job
}

fn render(renderer: &dyn Renderer, job: &Job, edge: Option<u32>) -> Result<Vec<TilePixels>, RenderError> {
    let film = job.image.film();
    let (width, height, samples) = (film.width, film.height, job.image.samples.max());
    let rects = Tiling { width, height, samples, pixel_bytes: film.pixel_bytes(), tile_edge: edge }.tiles();
    let runs: Vec<TileRequest<'_>> = rects.into_iter().map(|rect| TileRequest { job, frame: 0, rect }).collect();
    renderer.render_tiles(&runs, &CancelFlag::new(), &|_| {})
}

/// Returns the number of bytes, and of differing bytes.
fn compared(got: &[TilePixels], want: &[TilePixels]) -> (u64, u64) {
    let bytes = |tiles: &[TilePixels]| {
        let values = tiles.iter().flat_map(|tile| tile.planes.iter().flatten());
        values.flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>()
    };
    let (got, want) = (bytes(got), bytes(want));
    let differing = got.iter().zip(&want).filter(|(got, want)| got != want).count();
    (got.len() as u64, (differing + got.len().abs_diff(want.len())) as u64)
}

/// A hash of all pixels that does not depend on how they were cut into tiles.
fn hash(job: &Job, tiles: &[TilePixels]) -> String {
    let film = job.image.film();
    let (width, length) = (film.width as usize, film.pixels() as usize);
    let mut hasher = blake3::Hasher::new();
    // With what fireflies are reweighted by, if they are.
    let channels = if job.image.is_reweighted() { film.rendered_channels() } else { film.channels() };
    for plane in 0..channels.len() {
        let mut whole = vec![0; length * size_of::<f32>()];
        for tile in tiles {
            let rows = tile.planes[plane].chunks_exact(tile.rect.width as usize);
            for (y, row) in (tile.rect.y as usize..).zip(rows) {
                let start = (y * width + tile.rect.x as usize) * size_of::<f32>();
                let place = whole[start..].chunks_exact_mut(size_of::<f32>());
                place.zip(row).for_each(|(bytes, value)| bytes.copy_from_slice(&value.to_le_bytes()));
            }
        }
        hasher.update(&whole);
    }
    hasher.finalize().to_hex()[..32].to_owned()
}
