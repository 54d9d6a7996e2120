//! Exact arithmetic: the number type of formulas, vectors, rays, boxes, random samples and colors.
//!
//! Knows nothing of scenes. A formula is written once, generic over [`real::Real`], and gives the same bits in each
//! arithmetic; over intervals it gives bounds of all values in a box.
//!
//! ```
//! use math::real::{Interval, Real, Vec3, vec3};
//!
//! /// Distance to a ball of radius 1.
//! fn ball<R: Real>(p: Vec3<R>) -> R {
//!     p.length() - 1.0
//! }
//!
//! assert_eq!(ball(vec3(0.0, 3.0, 4.0)), 4.0);
//!
//! // In all of this box, the distance is between 1 and √12 − 1.
//! let side = Interval::new(-2.0, 2.0);
//! let range = ball(vec3(Interval::new(2.0, 2.0), side, side));
//! assert!(range.contains(1.0) && range.contains(2.4) && !range.contains(0.9));
//! ```

pub mod bounds;
pub mod color;
pub mod ray;
pub mod real;
pub mod sampling;

/// Name of a type in JSON and in generated source: `InfiniteCylinder` becomes `infinite_cylinder`.
pub fn snake_case(name: &str) -> String {
    let mut snake = String::new();
    for (index, letter) in name.char_indices() {
        if letter.is_ascii_uppercase() && index > 0 {
            snake.push('_');
        }
        snake.push(letter.to_ascii_lowercase());
    }
    snake
}
