//! sRGB and linear light: IEC 61966-2-1.

use crate::real::Real;

/// An sRGB value, 0 to 1, from linear light, which is clamped to 0 to 1 first.
#[inline(always)]
pub fn srgb_from_linear<R: Real>(linear: R) -> R {
    let linear = linear.at_least(0.0).at_most(1.0);
    let curve = linear.powf(linear.splat(1.0 / 2.4)).mul_add(linear.splat(1.055), linear.splat(-0.055));
    R::select(linear.below(0.003_130_8), linear * 12.92, curve).at_most(1.0)
}

/// Linear light from an sRGB value, 0 to 1.
#[inline(always)]
pub fn linear_from_srgb<R: Real>(srgb: R) -> R {
    let curve = ((srgb + 0.055) / 1.055).powf(srgb.splat(2.4));
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
    fn the_ends_of_16_bits_are_reached() {
        let quantised = |linear: f32| (srgb_from_linear(linear) * 65_535.0 + 0.5).floor();
        assert_eq!(srgb_from_linear(0.0_f32), 0.0);
        assert_eq!(quantised(1.0), 65_535.0);
        assert_eq!(quantised(7.0), 65_535.0);
        assert!((linear_from_srgb(1.0_f32) - 1.0).abs() < 1e-6);
    }
}
