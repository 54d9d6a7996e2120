//! Records the formulas of a picture, for every compiler.

use scene::cells::CellBuilder;
use scene::color::{level_of_256, srgb_from_linear};
use scene::film::DisplayTransform;
use scene::integrator::{Coverage, Guides, LayerValues, Rank, Ranks};
use scene::real::{Real, vec3};
use scene::sampling::thresholds;
use scene::{ImageSpec, Integrator, JobAtFrame, Layer};

use crate::tape::{Recording, Tape, record};

/// Adds samples to the sum of a pixel: column, row, first sample, end of the samples, and the sum: red, green, blue, alpha,
/// and the sums of its parts. Results are the new sum.
pub(crate) const ACCUMULATE: &str = "accumulate";
/// Color of a pixel from the sum of its samples.
pub(crate) const MEAN: &str = "mean";
/// Layers of the pixel in a column and row, one result for each channel.
pub(crate) const LAYERS: &str = "layers";
/// Levels from 0 to 255 of a pixel as a PNG of 8 bits has them, before their fractions are truncated: linear red, green,
/// blue with straight alpha, column, row.
pub(crate) const LEVELS: &str = "levels";
/// Number of evaluations of the scene's distance for some samples of a pixel: column, row, first sample, end of the
/// samples.
pub(crate) const EVALUATIONS: &str = "evaluations";
/// The scene's distance at a point. Not "distance": that is the name of a step of the scene.
pub const DISTANCE: &str = "distance_at_point";

/// Records the entries [`ACCUMULATE`], [`MEAN`] and, if the job requests layers, [`LAYERS`].
pub(crate) fn record_picture(at_frame: &JobAtFrame<'_>, cells: &dyn CellBuilder) -> Tape {
    record_entries(&Integrator::of_picture(at_frame, cells), at_frame)
}

/// Records the entries of [`record_picture`] of an integrator.
pub(crate) fn record_entries(program: &Integrator<'_>, at_frame: &JobAtFrame<'_>) -> Tape {
    record(|recording| {
        accumulate(recording, program, at_frame.image());
        finish(recording, program, at_frame.image());
    })
}

/// Records the entries [`MEAN`] and, if the image has layers, [`LAYERS`].
pub(crate) fn finish(recording: &Recording, program: &Integrator<'_>, image: &ImageSpec) {
    recording.entry_of(MEAN, image.film().sum_channels(), |all| program.mean(program.sum_of_channels(&all)).channels());
    if image.film().has_layers() {
        recording.entry(LAYERS, |[x, y]| layer_channels(program, image, x, y));
    }
}

/// Records the entry [`ACCUMULATE`].
pub(crate) fn accumulate(recording: &Recording, program: &Integrator<'_>, image: &ImageSpec) {
    recording.entry_of(ACCUMULATE, 4 + image.film().sum_channels(), |all| {
        let sum = program.sum_of_channels(&all[4..]);
        program.accumulate(all[0], all[1], all[2], all[3], sum).channels()
    });
}

/// Records the entries [`ACCUMULATE`] and [`LEVELS`].
pub(crate) fn record_shown_picture(at_frame: &JobAtFrame<'_>, cells: &dyn CellBuilder) -> Tape {
    let at_frame = &at_frame.without_parts_of_light();
    let program = Integrator::of_picture(at_frame, cells);
    let transform = DisplayTransform::new(at_frame.image());
    record(|recording| {
        accumulate(recording, &program, at_frame.image());
        recording.entry(LEVELS, |[red, green, blue, x, y]| {
            let level = |linear, threshold| level_of_256(srgb_from_linear(transform.apply(linear)), threshold);
            let [at_red, at_green, at_blue] = thresholds(x, y);
            vec![level(red, at_red), level(green, at_green), level(blue, at_blue)]
        });
    })
}

/// Records the entry [`EVALUATIONS`].
pub(crate) fn record_evaluations(at_frame: &JobAtFrame<'_>, cells: &dyn CellBuilder) -> Tape {
    let program = Integrator::of_picture(at_frame, cells);
    record(|recording| {
        recording.entry(EVALUATIONS, |[x, y, first, end]| {
            vec![program.accumulate(x, y, first, end, program.no_light(x.constant(0.0))).evaluations]
        });
    })
}

/// Records the entry [`DISTANCE`].
pub(crate) fn record_distance(at_frame: &JobAtFrame<'_>, cells: &dyn CellBuilder) -> Tape {
    let program = Integrator::of_picture(at_frame, cells);
    record(|recording| recording.entry(DISTANCE, |[x, y, z]| vec![program.distance(vec3(x, y, z))]))
}

/// The channels of a pixel's layers, and of what only its finishing reads.
pub(crate) fn layer_channels<R: Real>(program: &Integrator<'_>, image: &ImageSpec, x: R, y: R) -> Vec<R> {
    let mut channels = Vec::new();
    if !image.layers.is_empty() {
        let coverage = image.layers.iter().any(|layer| layer.is_matte()).then(|| program.coverage(x, y));
        channels.extend(channels_of(&program.layer_values(x, y), coverage.as_ref(), &image.layers));
    }
    if image.is_reweighted() {
        channels.push(x.uniform(image.samples.max() as f32));
    }
    if image.is_denoised() {
        let Guides { albedo, normal, inverse_depth } = program.guides(x, y);
        channels.extend(<[_; 3]>::from(albedo));
        channels.extend(<[_; 3]>::from(normal));
        // The error follows from the samples.
        channels.extend([inverse_depth, x.constant(0.0)]);
    }
    channels
}

fn channels_of<R: Real>(met: &LayerValues<R>, coverage: Option<&Coverage<R>>, layers: &[Layer]) -> Vec<R> {
    let matte = |of: fn(&Coverage<R>) -> Option<Ranks<R>>| {
        let Ranks(ranks) = coverage.and_then(of).expect("a layer of mattes has its coverage");
        ranks.into_iter().flat_map(|Rank { id, coverage }| [id, coverage]).collect()
    };
    let of_layer = |&layer: &Layer| match layer {
        Layer::Depth => vec![met.depth],
        Layer::Object => vec![met.object],
        Layer::Steps => vec![met.steps],
        Layer::Samples => vec![met.samples],
        // The denoiser replaces them.
        Layer::Noisy => vec![met.samples.constant(0.0); 3],
        Layer::CryptoObject => matte(|coverage| coverage.objects),
        Layer::CryptoMaterial => matte(|coverage| coverage.materials),
        Layer::Motion => <[_; 2]>::from(met.motion).to_vec(),
        Layer::Normal => <[_; 3]>::from(met.normal).to_vec(),
        Layer::Position => <[_; 3]>::from(met.position).to_vec(),
        Layer::Albedo => <[_; 3]>::from(met.albedo).to_vec(),
    };
    layers.iter().flat_map(of_layer).collect()
}
