//! Generates the page of what path tracing, lens, shutter, denoiser and media do, in pairs of pictures.

use std::fmt::Write as _;
use std::path::Path;

use scene::{Job, parse, set_value};

use super::{Page, Picture};

const HEAD: &str = "# Light, before and after

One job in each row, rendered with one thing changed: `sdfarm render FILE --set PLACE=VALUE`. The whole pictures are in
[the gallery](gallery.md#with-paths-of-light), the places in [jobs.md](jobs.md#path-tracing). This page is made from the code:
`SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs`.
";

/// Edge of the longer side of a picture, in pixels.
const SIZE_PX: u32 = 320;

/// Values that are set in a job, by their places.
type Changes = &'static [(&'static str, &'static str)];

/// A pair of pictures.
struct Pair {
    name: &'static str,
    title: &'static str,
    text: &'static str,
    /// Path of the job file from the docs, without its extension.
    scene: &'static str,
    samples: u32,
    /// Changes of both pictures, of the first, and of the second.
    both: Changes,
    before: Changes,
    after: Changes,
    /// Titles of the two pictures.
    captions: [&'static str; 2],
}

const PAIRS: &[Pair] = &[
    Pair {
        name: "bounces",
        title: "Light from wall to wall",
        text: "Walls color each other, the ceiling is lit by the floor, and the ball of glass lets light through to its caustic.",
        scene: "scenes/light/cornell",
        samples: 512,
        both: &[("image.denoise", "true")],
        before: &[("scene.integrator", "\"direct\""), ("image.denoise", "false")],
        after: &[],
        captions: ["`\"integrator\": \"direct\"`", "`\"integrator\": { \"path\": { \"max_bounces\": 8 } }`"],
    },
    Pair {
        name: "straight",
        title: "Light straight through glass",
        text: "Sixty-four samples of each pixel. Light that goes straight is found at once, but it is not gathered to a caustic: biased.",
        scene: "scenes/light/cornell",
        samples: 64,
        both: &[],
        before: &[],
        after: &[("scene.integrator.path.straight_shadows", "true")],
        captions: ["`\"straight_shadows\": false`", "`\"straight_shadows\": true`"],
    },
    Pair {
        name: "fireflies",
        title: "Fireflies",
        text: "Sixty-four samples of each pixel. Fireflies, samples far brighter than their neighbors, count less.",
        scene: "../scenes/lantern",
        samples: 64,
        both: &[("image.denoise", "false")],
        before: &[],
        after: &[("image.reweight_fireflies", "true")],
        captions: ["`\"reweight_fireflies\": false`", "`\"reweight_fireflies\": true`"],
    },
    Pair {
        name: "denoise",
        title: "The denoiser",
        text: "Sixteen samples of each pixel. Noise goes; edges, the caustic and refracted things stay.",
        scene: "scenes/light/cornell",
        samples: 16,
        both: &[],
        before: &[("image.denoise", "false")],
        after: &[("image.denoise", "true")],
        captions: ["`\"denoise\": false`", "`\"denoise\": true`"],
    },
    Pair {
        name: "samples",
        title: "Samples where they are needed",
        text: "About the same number of rays: 56 samples of each pixel, or from 8 to 256 by the noise of its block, 56.5 in the mean.",
        scene: "scenes/light/cornell",
        samples: 56,
        both: &[],
        before: &[],
        after: &[("image.samples", r#"{ "adaptive": { "min": 8, "max": 256, "error": 0.05 } }"#)],
        captions: [
            "`\"samples\": 56`",
            "`\"samples\": { \"adaptive\": { \"min\": 8, \"max\": 256, \"error\": 0.05 } }`",
        ],
    },
    Pair {
        name: "lens",
        title: "The lens",
        text: "A point before or behind the focus is as wide as the lens, in the shape of its six blades.",
        scene: "scenes/light/macro",
        samples: 256,
        both: &[("image.denoise", "true")],
        before: &[("scene.camera.lens.aperture", "0.0001")],
        after: &[],
        captions: ["`\"aperture\": 0.0001`", "`\"aperture\": 0.11`"],
    },
    Pair {
        name: "shutter",
        title: "The shutter",
        text: "The blades turn while it is open.",
        scene: "scenes/light/fan",
        samples: 128,
        both: &[("image.denoise", "true")],
        before: &[("frames.shutter", "0")],
        after: &[],
        captions: ["`\"shutter\": 0`", "`\"shutter\": 0.5`"],
    },
    Pair {
        name: "media",
        title: "Light inside of things",
        text: "The stone's skin is glass. Its inside scatters light, any number of times, until it leaves or is absorbed.",
        scene: "scenes/light/jade",
        samples: 128,
        both: &[("image.denoise", "true")],
        before: &[("scene.materials.stone.volume.density", "0.01")],
        after: &[],
        captions: ["`\"density\": 0.01`", "`\"density\": 22`"],
    },
];

impl Pair {
    /// The job after some changes, in the size of the page.
    fn job(&self, changes: [Changes; 2]) -> Job {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
        let text =
            std::fs::read_to_string(folder.join(self.scene).with_extension("json")).expect("a scene can be read");
        let whole = parse(text.as_bytes()).expect("a shipped scene is valid").image;
        let longer = whole.width.max(whole.height);
        let sizes = [("image.width", whole.width), ("image.height", whole.height)];
        let sizes = sizes.map(|(place, px)| (place, (px * SIZE_PX / longer).to_string()));
        let samples = [("image.samples", self.samples.to_string())];
        let fixed = sizes.iter().chain(&samples).map(|(place, value)| (*place, value.as_str()));
        let text = fixed.chain(changes.into_iter().flatten().copied()).fold(text, |text, (place, value)| {
            set_value(&text, place, value).unwrap_or_else(|fault| panic!("{}: {place} {fault}", self.scene))
        });
        parse(text.as_bytes()).unwrap_or_else(|refusal| panic!("{}: {refusal}", self.scene))
    }
}

pub(crate) fn page() -> Page {
    let mut page = Page { name: "light.md", text: HEAD.to_owned(), pictures: Vec::new() };
    for pair in PAIRS {
        let Pair { name, title, text, scene, captions: [before, after], .. } = pair;
        let (_, file) = scene.rsplit_once('/').expect("a file in a folder");
        let files = ["before", "after"].map(|which| format!("pictures/light/{name}-{which}.webp"));
        write!(
            page.text,
            "\n## {title}\n\n{text}\n\n| {before} | {after} |\n|---|---|\n| ![{title}, before]({}) | ![{title}, after]({}) |\n\nScene: \
             [{file}]({scene}.json)\n",
            files[0], files[1]
        )
        .expect("a String takes all");
        let jobs = [pair.job([pair.both, pair.before]), pair.job([pair.both, pair.after])];
        page.pictures.extend(files.into_iter().zip(jobs).map(|(file, job)| Picture::of_first_frame(file, job)));
    }
    page
}
