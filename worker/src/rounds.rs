//! How pictures end whose samples are taken in rounds: those with adaptive samples, and those that are denoised.
//!
//! One code for all devices: it decides with the sums of a block's pixels, and turns them into the block's numbers.

use scene::sample_count::standard_error;
use scene::{AdaptiveSamples, ImageSpec};

/// Channels of every picture, which decide about its samples: red, green, blue, alpha.
pub(crate) const CHANNELS: usize = 4;

/// Sums of the samples of a pixel: red, green, blue, alpha.
pub(crate) type Sums = [f32; CHANNELS];

/// The rules of a picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rounds<'a> {
    adaptive: Option<&'a AdaptiveSamples>,
    max_samples: u32,
    sum_channels: usize,
    samples_planes: [Option<usize>; 2],
    error_plane: Option<usize>,
}

impl<'a> Rounds<'a> {
    /// The rules of a picture; `None` if all its samples are taken at once.
    pub(crate) fn of(image: &'a ImageSpec) -> Option<Self> {
        let film = image.film();
        (image.rounds().len() > 1).then(|| Self {
            adaptive: image.samples.adaptive(),
            max_samples: image.samples.max(),
            sum_channels: film.sum_channels(),
            samples_planes: film.samples_planes(),
            error_plane: film.error_plane(),
        })
    }

    /// Greatest number of samples of a pixel.
    pub(crate) fn max_samples(&self) -> u32 {
        self.max_samples
    }

    /// Number of planes of sums, see [`scene::Film::sum_channels`].
    pub(crate) fn sum_channels(&self) -> usize {
        self.sum_channels
    }

    /// Whether a block whose pixels have these sums, of the samples before a round and after it, needs no more than the
    /// `count` that it has after the round. No block is done after the first.
    pub(crate) fn is_done(&self, round: usize, count: u32, sums: impl Iterator<Item = (Sums, Sums)>) -> bool {
        round > 0 && (count == self.max_samples || self.adaptive.is_some_and(|goal| goal.is_done(count, sums)))
    }

    /// Numbers of a finished pixel that do not follow from its sums: pairs of a plane and a number. Its last round
    /// doubled its samples to `count`, but for an odd one.
    pub(crate) fn extras(&self, count: u32, before: Sums, sum: Sums) -> impl Iterator<Item = (usize, f32)> {
        let samples = self.samples_planes.into_iter().flatten().map(move |plane| (plane, count as f32));
        let error = self.error_plane.map(|plane| (plane, standard_error([count / 2, count], before, sum)));
        samples.chain(error)
    }
}

/// The mean of a pixel's samples from their sum.
pub(crate) fn mean(count: u32, sum: f32) -> f32 {
    sum * (1.0 / count as f32)
}
