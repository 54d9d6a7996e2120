//! Display transform of linear light: exposure, tone map, and sRGB (IEC 61966-2-1).

use crate::job::{Image, ToneMap};
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
    pub fn new(image: &Image) -> Self {
        Self { exposure: power_of_two(image.exposure.get()), tone_map: image.tone_map }
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

/// Filmic tone map of a channel: linear light to linear display light, 0 to 1.
///
/// Krzysztof Narkowicz, "ACES Filmic Tone Mapping Curve", 2016, a fit to the Academy's curve:
/// <https://knarkowicz.wordpress.com/2016/01/06/aces-filmic-tone-mapping-curve/>.
pub fn filmic<R: Real>(linear: R) -> R {
    // Far above the input at which the curve reaches 1, and low enough that no square overflows.
    const MAX_INPUT: f32 = 1e4;
    let x = linear.at_least(0.0).at_most(MAX_INPUT);
    let over = x * x.mul_add(x.constant(2.51), x.constant(0.03));
    let under = x.mul_add(x.mul_add(x.constant(2.43), x.constant(0.59)), x.constant(0.14));
    (over / under).at_most(1.0)
}

/// sRGB value, 0 to 1, of linear light, which is first clamped to 0 to 1.
pub fn srgb_from_linear<R: Real>(linear: R) -> R {
    let linear = linear.at_least(0.0).at_most(1.0);
    let curve = linear.powf(linear.constant(1.0 / 2.4)).mul_add(linear.constant(1.055), linear.constant(-0.055));
    R::select(linear.below(0.003_130_8), linear * 12.92, curve).at_most(1.0)
}

/// Level from 0 to 255 of an sRGB value, 0 to 1, before its fraction is truncated: rounded at `threshold`, which
/// differs from pixel to pixel, so that slow gradients show no bands.
///
/// A value within rounding error of a level gets that level at every pixel, so that a constant color stays constant.
pub fn level_of_256<R: Real>(srgb: R, threshold: R) -> R {
    /// Maximum distance from a level that counts as rounding error, in levels.
    const NEAR: f32 = 1.0 / 32.0;
    let value = srgb * 255.0;
    let nearest = (value + 0.5).floor();
    R::select((value - nearest).abs().below(NEAR), nearest, value + threshold)
}

/// Linear light from an sRGB value, 0 to 1.
pub fn linear_from_srgb<R: Real>(srgb: R) -> R {
    let curve = ((srgb + 0.055) / 1.055).powf(srgb.constant(2.4));
    R::select(srgb.below(0.040_45), srgb / 12.92, curve)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_8_bit_value_survives_the_round_trip() {
        for value in 0..=255_u8 {
            let srgb = f32::from(value) / 255.0;
            let back = srgb_from_linear(linear_from_srgb(srgb)) * 255.0 + 0.5;
            assert_eq!(back.floor() as u8, value);
        }
    }

    #[test]
    fn an_integer_stop_is_exactly_a_factor_of_two() {
        for (stops, factor) in [(-20.0, 1.0 / 1_048_576.0), (-1.0, 0.5), (0.0, 1.0), (3.0, 8.0), (20.0, 1_048_576.0)] {
            assert_eq!(power_of_two(stops), factor);
        }
        assert!((power_of_two(0.5) / 2.0_f32.sqrt() - 1.0).abs() < 1e-6);
        assert!((power_of_two(-2.5) * 32.0_f32.sqrt() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn the_filmic_curve_rises_through_published_values() {
        assert_eq!(filmic(0.0_f32), 0.0);
        assert_eq!(filmic(-1.0_f32), 0.0);
        // (2.51 + 0.03)/(2.43 + 0.59 + 0.14), and the same for 0.18.
        assert!((filmic(1.0_f32) - 0.803_797_5).abs() < 1e-6);
        assert!((filmic(0.18_f32) - 0.266_898_9).abs() < 1e-6);
        assert!([10.0_f32, 1e6, f32::MAX, f32::INFINITY].iter().all(|&bright| filmic(bright) == 1.0));
        let values: Vec<f32> = (0..2_000).map(|step| filmic(step as f32 * 0.005)).collect();
        assert!(values.windows(2).all(|pair| pair[0] <= pair[1]));
    }

    #[test]
    fn the_ends_of_16_bits_are_reached() {
        let quantized = |linear: f32| (srgb_from_linear(linear) * 65_535.0 + 0.5).floor();
        assert_eq!(srgb_from_linear(0.0_f32), 0.0);
        assert_eq!(quantized(1.0), 65_535.0);
        assert_eq!(quantized(7.0), 65_535.0);
        assert!((linear_from_srgb(1.0_f32) - 1.0).abs() < 1e-6);
    }
}
