//! Colors: sRGB (IEC 61966-2-1), a filmic tone map, and black bodies.

use crate::real::{Real, Vec3, vec3};

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

/// Linear light of a black body of a temperature from 1700 to 25,000 K, scaled so that its brightest channel is 1.
///
/// The Planckian locus by the cubic splines of Kim, Kim, Kim, Park and Song, "Design of advanced color temperature control
/// system for HDTV applications", Journal of the Korean Physical Society 41(6), 2002. Colors outside sRGB are clamped to it.
pub fn of_temperature(kelvin: f32) -> Vec3<f32> {
    let per_kelvin = 1000.0 / kelvin;
    let cubic = |x: f32, [a, b, c, d]: [f32; 4]| ((a * x + b) * x + c) * x + d;
    let x = if kelvin <= 4_000.0 {
        cubic(per_kelvin, [-0.266_123_9, -0.234_358_9, 0.877_695_6, 0.179_91])
    } else {
        cubic(per_kelvin, [-3.025_846_9, 2.107_037_9, 0.222_634_7, 0.240_39])
    };
    let y = if kelvin <= 2_222.0 {
        cubic(x, [-1.106_381_4, -1.348_110_2, 2.185_558_3, -0.202_196_83])
    } else if kelvin <= 4_000.0 {
        cubic(x, [-0.954_947_6, -1.374_185_9, 2.091_370_2, -0.167_488_67])
    } else {
        cubic(x, [3.081_758, -5.873_387, 3.751_13, -0.370_014_83])
    };
    // XYZ of luminance 1, and the matrix of IEC 61966-2-1.
    let (x, z) = (x / y, (1.0 - x - y) / y);
    let light = [
        3.240_97 * x - 1.537_383_2 - 0.498_610_76 * z,
        -0.969_243_65 * x + 1.875_967_5 + 0.041_555_06 * z,
        0.055_630_08 * x - 0.203_976_96 + 1.056_971_5 * z,
    ];
    let light = light.map(|channel| channel.max(0.0));
    let brightest = light[0].max(light[1]).max(light[2]);
    let [red, green, blue] = light.map(|channel| channel / brightest);
    vec3(red, green, blue)
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
    fn a_black_body_has_the_color_of_its_temperature() {
        // Chromaticities of the Planckian locus (Wyszecki and Stiles, "Color Science", 1982); 2856 K is CIE illuminant A.
        for (kelvin, x, y) in [
            (2_000.0, 0.5267, 0.4133),
            (2_856.0, 0.4476, 0.4074),
            (3_000.0, 0.4369, 0.4041),
            (5_000.0, 0.3451, 0.3516),
            (6_500.0, 0.3135, 0.3237),
            (10_000.0, 0.2807, 0.2884),
        ] {
            let [r, g, b] = <[f32; 3]>::from(of_temperature(kelvin));
            assert!(r.max(g).max(b) == 1.0 && r.min(g).min(b) > 0.0, "{kelvin} K");
            let xyz = [
                0.412_390_8 * r + 0.357_584_34 * g + 0.180_480_79 * b,
                0.212_639 * r + 0.715_168_7 * g + 0.072_192_32 * b,
                0.019_330_82 * r + 0.119_194_78 * g + 0.950_532_15 * b,
            ];
            let sum: f32 = xyz.iter().sum();
            let distance = (xyz[0] / sum - x).abs().max((xyz[1] / sum - y).abs());
            assert!(distance < 0.001, "{kelvin} K: {} {}", xyz[0] / sum, xyz[1] / sum);
        }
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
