//! Positions of scattered copies, by dart throwing: positions are tried in an order that follows from the seed alone,
//! and one is taken if it is far enough from all others.
//!
//! Robert L. Cook, "Stochastic sampling in computer graphics", ACM Transactions on Graphics 5(1), 1986; a grid of cells
//! as wide as the distance finds the others that are near.

use std::collections::HashMap;

use super::region::ScatterRegion;
use super::surface::SurfaceBelow;
use crate::real::Vec3;
use crate::sampling::hashed_numbers;

/// Number of positions tried for each copy.
const TRIES_PER_COPY: u32 = 64;
/// Number of positions in a row without a copy after which no more are expected to fit.
const MAX_MISSES: u32 = 2048;
/// Dimensions of the hash: a position, and the choices of its copy.
const POSITION: u32 = 0;
const CHOICES: u32 = 1;

/// A position, and numbers from 0 to 1 that choose the copy's shape, rotation and scale.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dart {
    pub position: Vec3<f32>,
    pub choices: [f32; 3],
}

/// Positions of at most `count` copies, each at least `apart` from the others.
pub(super) fn throw(
    count: u32,
    seed: u32,
    region: &ScatterRegion,
    apart: f32,
    surface: Option<&mut SurfaceBelow<'_>>,
) -> Vec<Dart> {
    let (mut darts, mut near, mut surface) = (Vec::new(), Cells::new(apart), surface);
    let mut misses = 0;
    for index in 0..count.saturating_mul(TRIES_PER_COPY) + MAX_MISSES {
        if darts.len() == count as usize || misses == MAX_MISSES {
            break;
        }
        misses += 1;
        let Some(inside) = region.point(hashed_numbers(seed, index, POSITION)) else { continue };
        let landed = match &mut surface {
            Some(surface) => surface.below(inside),
            None => Some(inside),
        };
        if let Some(position) = landed.filter(|&position| near.insert(position)) {
            darts.push(Dart { position, choices: hashed_numbers(seed, index, CHOICES) });
            misses = 0;
        }
    }
    darts.sort_by_key(|dart| region.place_along_curve(dart.position));
    darts
}

/// Taken positions by the cell of a grid.
struct Cells {
    apart: f32,
    taken: HashMap<[i64; 3], Vec<Vec3<f32>>>,
}

impl Cells {
    fn new(apart: f32) -> Self {
        Self { apart, taken: HashMap::new() }
    }

    /// Takes a position, unless it is too near to another.
    fn insert(&mut self, position: Vec3<f32>) -> bool {
        if self.apart == 0.0 {
            return true;
        }
        let cell = <[f32; 3]>::from(position).map(|c| (c / self.apart).floor() as i64);
        let is_near = |other: &Vec3<f32>| (*other - position).length_squared() < self.apart * self.apart;
        for step in 0..27_i64 {
            let next = [cell[0] + step % 3 - 1, cell[1] + step / 3 % 3 - 1, cell[2] + step / 9 - 1];
            if self.taken.get(&next).is_some_and(|taken| taken.iter().any(is_near)) {
                return false;
            }
        }
        self.taken.entry(cell).or_default().push(position);
        true
    }
}
