//! Common parts of lattice noises: the cell of a point, and a random hash of each of its corners.
//!
//! The hash multiplies each index by an odd constant, adds them and mixes once: a short form of those in Mark
//! Jarzynski and Marc Olano, "Hash functions for GPU rendering", Journal of Computer Graphics Techniques 9(3), 2020,
//! <https://jcgt.org/published/0009/03/02/>.

use crate::real::{Real, Vec3, vec3};

/// Cell coordinates are clamped to this along each axis, because an `f32` has hardly any fraction left there.
const MAX_CELL: f32 = 4_194_303.0;
/// Added to an integer of up to ±2²², it puts that integer into the low bits of an `f32`.
const INTEGER_BIAS: f32 = 12_582_912.0;

/// The odd constants of x, y and z.
const X_STEP: u32 = 0x8da6_b343;
const Y_STEP: u32 = 0xd816_3841;
const Z_STEP: u32 = 0xcb1a_b31f;

/// Index along each axis of a point's cell, or of a corner, in the form that the hash uses.
#[derive(Clone, Copy, Debug)]
pub(super) struct LatticeHash<R: Real> {
    x: R::Bits,
    y: R::Bits,
    z: R::Bits,
}

/// Minimum corner of the cell of `p`, in integers, and the position of `p` in the cell, 0 to 1 along each axis.
pub(super) fn cell<R: Real>(p: Vec3<R>) -> (Vec3<R>, Vec3<R>) {
    let p = p.map(|c| c.at_least(-MAX_CELL).at_most(MAX_CELL));
    let corner = vec3(p.x.floor(), p.y.floor(), p.z.floor());
    (corner, p - corner)
}

impl<R: Real> LatticeHash<R> {
    /// Hash of the corner at integers up to ±2²², with `seed` from [`octave_seed`].
    pub(super) fn new(corner: Vec3<R>, seed: R) -> Self {
        Self {
            x: ((corner.x + INTEGER_BIAS).to_bits() * X_STEP) ^ seed.to_bits(),
            y: (corner.y + INTEGER_BIAS).to_bits() * Y_STEP,
            z: (corner.z + INTEGER_BIAS).to_bits() * Z_STEP,
        }
    }

    /// Both indices along each axis of the cell that starts at `corner`.
    pub(super) fn pair(corner: Vec3<R>, seed: R) -> [Self; 2] {
        let seed = seed.to_bits();
        let x = (corner.x + INTEGER_BIAS).to_bits() * X_STEP;
        let y = (corner.y + INTEGER_BIAS).to_bits() * Y_STEP;
        let z = (corner.z + INTEGER_BIAS).to_bits() * Z_STEP;
        [Self { x: x ^ seed, y, z }, Self { x: (x + X_STEP) ^ seed, y: y + Y_STEP, z: z + Z_STEP }]
    }

    /// Pseudorandom bits: the upper ones are the best.
    pub(super) fn hash(self) -> R::Bits {
        Self::word_of(self.x, self.y, self.z)
    }

    fn word_of(x: R::Bits, y: R::Bits, z: R::Bits) -> R::Bits {
        let word = x ^ y ^ z;
        (word ^ (word >> 15)) * 0x27d4_eb2d
    }

    /// Pseudorandom bits, all equally good (Chris Wellons, "Prospecting for hash functions",
    /// <https://nullprogram.com/blog/2018/07/31/>).
    pub(super) fn mixed_hash(self) -> R::Bits {
        let word = self.x ^ self.y ^ self.z;
        let word = (word ^ (word >> 16)) * 0x7feb_352d;
        let word = (word ^ (word >> 15)) * 0x846c_a68b;
        word ^ (word >> 16)
    }
}

/// Hashes of a cell's eight corners; x changes fastest.
pub(super) fn corner_hashes<R: Real>([low, high]: [LatticeHash<R>; 2]) -> [R::Bits; 8] {
    let word = LatticeHash::<R>::word_of;
    [
        word(low.x, low.y, low.z),
        word(high.x, low.y, low.z),
        word(low.x, high.y, low.z),
        word(high.x, high.y, low.z),
        word(low.x, low.y, high.z),
        word(high.x, low.y, high.z),
        word(low.x, high.y, high.z),
        word(high.x, high.y, high.z),
    ]
}

/// Seed of an octave as a number with random bits that is finite, normal and not 0; and the octave's offset within its
/// cells, so that the corners of several octaves do not coincide.
pub(super) fn octave_seed(seed: u32, salt: u32) -> (f32, Vec3<f32>) {
    let word = crate::sampling::frame_key(seed, salt);
    let places = word.wrapping_mul(0x9e37_79b9);
    let part = |low: u32| (places >> low & 0x3ff) as f32 / 1024.0;
    (f32::from_bits((word & 0xbfff_ffff) | 0x2000_0000), vec3(part(2), part(12), part(22)))
}

/// Number from 1 to 2, excluding 2, from the upper 23 bits of a hash.
pub(super) fn float_in_1_2<R: Real>(word: R::Bits) -> R {
    R::from_bits((word >> 9) | 0x3f80_0000)
}

/// `number`, negated if the sign bit of `hash` is set.
pub(super) fn with_sign<R: Real>(number: R, word: R::Bits) -> R {
    R::from_bits(number.to_bits() ^ (word & 0x8000_0000))
}

/// Dot product of `v` with one of the twelve directions to the centers of a cube's edges, (±1, ±1, 0) and so on,
/// selected by the hash: Ken Perlin's gradients.
pub(super) fn gradient_dot<R: Real>(v: Vec3<R>, word: R::Bits) -> R {
    let third = R::from_bits(((word >> 7) & 0x007f_ffff) | 0x3f80_0000);
    let first = R::select(third.below(5.0 / 3.0), v.x, v.y);
    let second = R::select(third.below(4.0 / 3.0), v.y, v.z);
    with_sign(first, word) + with_sign(second, word << 1)
}

/// t³(6t² − 15t + 10): from 0 to 1 with zero slope and curvature at both ends (Perlin 2002).
fn fade<R: Real>(t: R) -> R {
    let curve = t.mul_add(t.mul_add(t.constant(6.0), t.constant(-15.0)), t.constant(10.0));
    t * t * t * curve
}

fn mix<R: Real>(a: R, b: R, t: R) -> R {
    t.mul_add(b - a, a)
}

/// Trilinear interpolation of the values at a cell's corners, with x changing fastest.
pub(super) fn trilinear<R: Real>(corners: [R; 8], fraction: Vec3<R>) -> R {
    let Vec3 { x, y, z } = fraction.map(|t| fade(t));
    let [a, b, c, d, e, f, g, h] = corners;
    let near = mix(mix(a, b, x), mix(c, d, x), y);
    let far = mix(mix(e, f, x), mix(g, h, x), y);
    mix(near, far, z)
}

/// The vectors from a cell's eight corners to the point at `fraction`.
pub(super) fn corner_offsets<R: Real>(low: Vec3<R>) -> [Vec3<R>; 8] {
    let high = low.map(|c| c - 1.0);
    [
        low,
        vec3(high.x, low.y, low.z),
        vec3(low.x, high.y, low.z),
        vec3(high.x, high.y, low.z),
        vec3(low.x, low.y, high.z),
        vec3(high.x, low.y, high.z),
        vec3(low.x, high.y, high.z),
        high,
    ]
}
