//! Display transform of linear light: exposure and tone map.

use super::{ImageSpec, ToneMap};
use crate::color::filmic;
use crate::real::Real;

/// Display transform of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisplayTransform {
    /// Factor of the linear light.
    exposure: f32,
    tone_map: ToneMap,
}

impl DisplayTransform {
    /// Display transform of an image.
    pub fn new(image: &ImageSpec) -> Self {
        Self { exposure: power_of_two(image.exposure.in_frame()), tone_map: image.tone_map }
    }

    /// Display value of a channel's linear light.
    pub fn apply<R: Real>(self, linear: R) -> R {
        let exposed = linear * linear.uniform(self.exposure);
        match self.tone_map {
            ToneMap::None => exposed,
            ToneMap::Filmic => filmic(exposed),
        }
    }
}

/// 2 to a power within ±120; exact for integers.
fn power_of_two(power: f32) -> f32 {
    let whole = power.floor();
    let exponent = (127.0 + whole) as u32;
    f32::from_bits(exponent << 23) * Real::powf(2.0_f32, power - whole)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_integer_stop_is_exactly_a_factor_of_two() {
        for (stops, factor) in [(-20.0, 1.0 / 1_048_576.0), (-1.0, 0.5), (0.0, 1.0), (3.0, 8.0), (20.0, 1_048_576.0)] {
            assert_eq!(power_of_two(stops), factor);
        }
        assert!((power_of_two(0.5) / 2.0_f32.sqrt() - 1.0).abs() < 1e-6);
        assert!((power_of_two(-2.5) * 32.0_f32.sqrt() - 1.0).abs() < 1e-6);
    }
}
