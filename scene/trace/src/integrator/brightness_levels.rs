//! Light by the brightness of its samples: what fireflies are reweighted by, after Tobias Zirr, Johannes Hanika and Carsten
//! Dachsbacher, "Re-weighting firefly samples for improved finite-sample Monte Carlo estimates", Computer Graphics Forum
//! 37(6), 2018.
//!
//! Levels are powers of [`LEVEL_RATIO`] apart. A sample between two is split among them, so that the sum of its parts, each
//! over its level's brightness, is 1: a level's light over its brightness is the number of samples that it comes from.

use super::Integrator;
use super::colors::Colors;
use crate::film::BRIGHTNESS_LEVELS;
use crate::real::{Real, Vec3};

/// Brightness of level 0, which is not stored: what is left of the light.
pub const LEAST_BRIGHTNESS: f32 = 1.0 / 8.0;
/// Brightness of a level over that of the one below.
pub const LEVEL_RATIO: f32 = 8.0;

/// Light of each level above level 0; nothing if fireflies stay as they are.
pub type LeveledLight<R> = Colors<R, BRIGHTNESS_LEVELS>;

impl Integrator<'_> {
    /// The light of a sample by its brightness.
    pub(super) fn leveled<R: Real>(&self, light: Vec3<R>) -> LeveledLight<R> {
        if self.levels == 0 { LeveledLight::none() } else { LeveledLight::of(parts(light)) }
    }
}

/// The parts of a sample's light that are in each level above level 0.
fn parts<R: Real>(light: Vec3<R>) -> [Vec3<R>; BRIGHTNESS_LEVELS] {
    let (none, all) = (light.x.constant(0.0), light.x.constant(1.0));
    let per_brightness = all / light.max_element().max(light.x.constant(LEAST_BRIGHTNESS));
    let mut below = LEAST_BRIGHTNESS;
    // The share of the light that is in a level or above it.
    let shares: [R; BRIGHTNESS_LEVELS] = std::array::from_fn(|_| {
        let share = (all - per_brightness * below) * (LEVEL_RATIO / (LEVEL_RATIO - 1.0));
        below *= LEVEL_RATIO;
        share.max(none).min(all)
    });
    std::array::from_fn(|level| light * (shares[level] - shares.get(level + 1).copied().unwrap_or(none)))
}

#[cfg(test)]
mod tests {
    use super::{LEAST_BRIGHTNESS, LEVEL_RATIO, parts};
    use crate::film::BRIGHTNESS_LEVELS;
    use crate::real::vec3;

    #[test]
    fn the_parts_of_a_sample_over_their_levels_brightness_sum_to_one() {
        let mut brightness = LEAST_BRIGHTNESS;
        while brightness < 4096.0 {
            let parts = parts(vec3(brightness, 0.5 * brightness, 0.0));
            assert!(parts.iter().all(|part| part.x >= 0.0 && part.y == 0.5 * part.x && part.z == 0.0));
            let levels = std::iter::successors(Some(1.0), |level| Some(level * LEVEL_RATIO));
            let rest = brightness - parts.iter().map(|part| part.x).sum::<f32>();
            let samples: f32 = parts.iter().zip(levels).map(|(part, level)| part.x / level).sum();
            let sum = samples + rest / LEAST_BRIGHTNESS;
            assert!((sum - 1.0).abs() < 1e-3, "{brightness}: {sum}");
            // Levels that are not beside the sample have nothing of it.
            let used = parts.iter().filter(|part| part.x > 1e-6 * brightness).count();
            assert!(used <= 2, "{brightness}: {parts:?}");
            brightness *= 1.37;
        }
    }

    #[test]
    fn a_dim_sample_is_in_level_0_alone_and_a_very_bright_one_in_the_last() {
        assert!(parts(vec3(0.125, 0.1, -0.2)).iter().all(|part| part.x == 0.0 && part.z == 0.0));
        let bright = parts(vec3(1e9, 0.0, 0.0));
        assert!((bright[BRIGHTNESS_LEVELS - 1].x / 1e9 - 1.0).abs() < 1e-5, "{bright:?}");
    }
}
