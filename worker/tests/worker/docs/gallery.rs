//! Generates the page of shipped scenes.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use scene::transport::Transport;
use scene::{Format, ImageSpec, Job};

use super::{Page, Picture};

const HEAD: &str = "# Gallery

The scenes that come with sdfarm, drawn small: `sdfarm render scenes/NAME.json -o NAME.png` renders one in full. This
page is made from them: `SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs`.
";

/// Headings, folders of the repository, and where the pictures are in `docs/pictures/gallery`.
const PARTS: [(&str, &str, &str); 4] = [
    ("", "scenes", ""),
    ("\n# Of the paper\n", "scenes/paper", "paper/"),
    (
        "\n# With names, formulas and copies\n\nThese jobs say each thing once: named shapes and numbers, formulas, copies, scatters and tracks.\n",
        "docs/scenes",
        "written/",
    ),
    (
        "\n# With paths of light\n\nIn these jobs light travels from surface to surface: `integrator` is `path` ([jobs.md](jobs.md#path-tracing)).\n",
        "docs/scenes/light",
        "light/",
    ),
];

const WIDTH: u32 = 400;
const MAX_SAMPLES: u32 = 12;
/// Of a job with paths of light, which has more noise.
const MAX_SAMPLES_OF_PATHS: u32 = 96;

fn jobs(folder: &Path) -> Vec<(String, Job)> {
    let entries = std::fs::read_dir(folder).expect("there are scenes");
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("a folder can be read").path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "json"));
    files.sort();
    let job = |file: PathBuf| {
        let name = file.file_stem().expect("a file has a name").to_string_lossy().into_owned();
        let text = std::fs::read(&file).expect("a scene can be read");
        (name, scene::parse(&text).expect("a shipped scene is valid"))
    };
    files.into_iter().map(job).collect()
}

/// The job in the form that the page shows.
fn small(job: Job) -> Job {
    let height = (WIDTH * job.image.height).div_ceil(job.image.width);
    let is_of_paths = job.scene.integrator != Transport::Direct;
    let samples = job.image.samples.max().min(if is_of_paths { MAX_SAMPLES_OF_PATHS } else { MAX_SAMPLES });
    let mut image =
        ImageSpec { width: WIDTH, height, samples: samples.into(), format: Format::Png, ..job.image.clone() };
    image.clear_layers();
    job.with_image(image)
}

pub(crate) fn page() -> Page {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut page = Page { name: "gallery.md", text: HEAD.to_owned(), pictures: Vec::new() };
    for (heading, folder, pictures) in PARTS {
        page.text += heading;
        for (name, job) in jobs(&root.join(folder)) {
            let file = format!("pictures/gallery/{pictures}{name}.webp");
            let ImageSpec { width, height, ref samples, .. } = job.image;
            let samples = samples.max();
            let frames = if job.frames.count > 1 { format!(", {} frames", job.frames.count) } else { String::new() };
            write!(
                page.text,
                "\n## [{name}](../{folder}/{name}.json)\n\n{} nodes, {width}×{height} × {samples}{frames}\n\n![{name}]({file})\n",
                job.nodes()
            )
            .expect("a String takes all");
            // Everything that moves in these jobs has arrived in the last frame.
            let frame = if pictures == "written/" { job.frames.count - 1 } else { 0 };
            page.pictures.push(Picture { file, job: small(job), frame });
        }
    }
    page
}
