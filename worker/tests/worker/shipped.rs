//! Job files in scenes/, for tests that run all of them.

use std::path::Path;

use scene::{Bits, Format, ImageSpec, Job, Layer, Precision};

/// Every layer an EXR may have.
pub(crate) const LAYERS: [Layer; 10] = [
    Layer::Depth,
    Layer::Normal,
    Layer::Position,
    Layer::Albedo,
    Layer::Object,
    Layer::Steps,
    Layer::Samples,
    Layer::Motion,
    Layer::CryptoObject,
    Layer::CryptoMaterial,
];

/// A job file.
#[derive(Clone)]
pub(crate) struct Shipped {
    /// Its path in scenes/, without `.json`.
    pub(crate) name: String,
    /// Content of the file.
    pub(crate) text: Vec<u8>,
}

impl Shipped {
    pub(crate) fn job(&self) -> Job {
        scene::parse(&self.text).unwrap_or_else(|refusal| panic!("{}: {refusal}", self.name))
    }

    /// The job as a PNG of 8 bits, in this size.
    pub(crate) fn png(&self, width: u32, samples: u32) -> Job {
        let job = self.job();
        let mut image = ImageSpec { format: Format::Png, bits: Bits::Eight, ..job.image.clone() };
        image.clear_layers();
        sized(job.with_image(image), width, samples)
    }

    /// The job as a float EXR with every layer, in this size.
    pub(crate) fn exr(&self, width: u32, samples: u32) -> Job {
        let job = self.job();
        let image = ImageSpec {
            format: Format::Exr,
            precision: Precision::Float,
            layers: LAYERS.to_vec(),
            ..job.image.clone()
        };
        sized(job.with_image(image), width, samples)
    }
}

/// The job in another size, with the same aspect ratio.
fn sized(job: Job, width: u32, samples: u32) -> Job {
    let height = (job.image.height * width / job.image.width).max(1);
    let image = ImageSpec { width, height, samples: samples.into(), ..job.image.clone() };
    job.with_image(image)
}

/// All of them, by name.
pub(crate) fn shipped() -> Vec<Shipped> {
    let found = of_folders(&[("", "scenes"), ("paper/", "scenes/paper")]);
    assert!(found.len() > 30, "scenes/ holds job files");
    found
}

/// Names of [`few`].
const FEW: [&str; 6] = ["csg", "dice", "mandelbulb", "paper/clouds", "turntable", "vitrine"];

/// Scenes that together have every sort of light, material, medium, texture, camera and fractal.
pub(crate) fn few() -> Vec<Shipped> {
    let mut scenes = shipped();
    scenes.retain(|shipped| FEW.contains(&shipped.name.as_str()));
    assert_eq!(scenes.len(), FEW.len());
    scenes
}

/// The scenes of the documents, and the jobs of the tutorial, by name.
pub(crate) fn large() -> Vec<Shipped> {
    let found = of_folders(&[("", "docs/scenes"), ("light/", "docs/scenes/light"), ("tutorial/", "docs/tutorial")]);
    assert!(found.len() > 17, "docs/scenes/ and docs/tutorial/ hold job files");
    found
}

/// The job files of folders, with prefixes of their names.
fn of_folders(folders: &[(&str, &str)]) -> Vec<Shipped> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut found = Vec::new();
    for (prefix, folder) in folders {
        for entry in std::fs::read_dir(root.join(folder)).expect("there are scenes") {
            let path = entry.expect("a folder can be read").path();
            if path.extension().is_some_and(|extension| extension == "json") {
                let stem = path.file_stem().expect("a file has a name").to_string_lossy().into_owned();
                let text = std::fs::read(&path).expect("a scene can be read");
                found.push(Shipped { name: format!("{prefix}{stem}"), text });
            }
        }
    }
    found.sort_by(|left, right| left.name.cmp(&right.name));
    found
}
