//! Triply periodic minimal surfaces: they repeat along all three axes and divide space into two congruent mazes.
//!
//! Each is approximated, as usual, by the zero set of a sum f of products of sines and cosines; for the surfaces see
//! Alan H. Schoen, "Infinite periodic minimal surfaces without self-intersections", NASA TN D-5541, 1970. With angles
//! of 2π per cell, f over its largest gradient is a bound of the distance. For all three that gradient has length √3,
//! as proved at each. The maximum is attained, so no smaller number would do.

use std::f32::consts::{PI, TAU};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::{Exactness, NodeError, Primitive};
use crate::bounds::Bounds;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Length;

/// Schoen's gyroid, infinite: intersect it with another shape.
///
/// f = sin x cos y + sin y cos z + sin z cos x.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Gyroid {
    /// Edge of the cube in which it repeats.
    pub cell: Length,
    /// Thickness of the wall where it is thinnest; when absent, one side of the surface is solid.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thickness: Option<Length>,
}

/// Schwarz's primitive surface, infinite: intersect it with another shape. Its chambers are at the centers and corners
/// of its cells.
///
/// f = cos x + cos y + cos z.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct SchwarzP {
    /// Edge of the cube in which it repeats.
    pub cell: Length,
    /// Thickness of the wall where it is thinnest; when absent, one side of the surface is solid.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thickness: Option<Length>,
}

/// Schwarz's diamond surface, infinite: intersect it with another shape. Its tunnels join in fours, like the bonds of
/// a diamond.
///
/// f = sin x sin y sin z + sin x cos y cos z + cos x sin y cos z + cos x cos y sin z.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Diamond {
    /// Edge of the cube in which it repeats.
    pub cell: Length,
    /// Thickness of the wall where it is thinnest; when absent, one side of the surface is solid.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thickness: Option<Length>,
}

/// The largest gradient of each f: √3.
const MAX_GRADIENT: f32 = 1.732_050_8;

impl Primitive for Gyroid {
    const EXAMPLE: &str = r#"{ "cell": 1.2, "thickness": 0.08 }"#;
    const MORE_EXAMPLES: &[&str] = &[r#"{ "cell": 1.6 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        // ∂f/∂x = cos x cos y − sin z sin x is the product of (cos x, −sin x) and (cos y, sin z): its
        // square is at most cos²y + sin²z. Likewise the squares of ∂f/∂y and ∂f/∂z are at most
        // cos²z + sin²x and cos²x + sin²y. The sum is 3.
        let (sine, cosine) = cell_sin_cos(p, &self.cell);
        let f = sine.x.mul_add(cosine.y, sine.y.mul_add(cosine.z, sine.z * cosine.x));
        slab_around_zero(f, &self.cell, self.thickness.as_ref())
    }

    fn exactness(&self) -> Exactness {
        Exactness::Bound
    }

    fn bounds(&self, _: f32) -> Bounds {
        Bounds::INFINITE
    }

    fn validate(&self) -> Option<NodeError> {
        // sin x cos y is at most (sin²x + cos²y)/2, so |f| is at most 3/2.
        thickness_error(&self.cell, self.thickness.as_ref(), 1.5)
    }
}

impl Primitive for SchwarzP {
    const EXAMPLE: &str = r#"{ "cell": 1.1, "thickness": 0.1 }"#;
    const MORE_EXAMPLES: &[&str] = &[r#"{ "cell": 1.4 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        // The gradient (−sin x, −sin y, −sin z) has a square of 3 at most.
        let (_, cosine) = cell_sin_cos(p, &self.cell);
        slab_around_zero(cosine.x + (cosine.y + cosine.z), &self.cell, self.thickness.as_ref())
    }

    fn exactness(&self) -> Exactness {
        Exactness::Bound
    }

    fn bounds(&self, _: f32) -> Bounds {
        Bounds::INFINITE
    }

    fn validate(&self) -> Option<NodeError> {
        thickness_error(&self.cell, self.thickness.as_ref(), 3.0)
    }
}

impl Primitive for Diamond {
    const EXAMPLE: &str = r#"{ "cell": 1.5, "thickness": 0.08 }"#;
    const MORE_EXAMPLES: &[&str] = &[r#"{ "cell": 2 }"#];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        // f = sin x cos(y − z) + cos x sin(y + z), and cyclically. Squaring ∂f/∂x = cos x cos(y − z) − sin x sin(y +
        // z) and the others, with products expanded to double angles: let c and s be the cosines and sines of 2x, 2y,
        // 2z, then |∇f|² = (3 + 3·c₁c₂c₃ − (s₁s₂ + s₂s₃ + s₃s₁))/2. Because |c| ≤ 1, 3·c₁c₂c₃ ≤ 3·(c₁²c₂²c₃²)^⅓ ≤ Σc²
        // by the inequality of means; and −(s₁s₂ + s₂s₃ + s₃s₁) = (Σs² − (Σs)²)/2 ≤ Σs². Since c² + s² = 1, both
        // together are at most 3, and so is |∇f|².
        let (sine, cosine) = cell_sin_cos(p, &self.cell);
        let of_difference = cosine.y.mul_add(cosine.z, sine.y * sine.z);
        let of_sum = sine.y.mul_add(cosine.z, cosine.y * sine.z);
        let f = sine.x.mul_add(of_difference, cosine.x * of_sum);
        slab_around_zero(f, &self.cell, self.thickness.as_ref())
    }

    fn exactness(&self) -> Exactness {
        Exactness::Bound
    }

    fn bounds(&self, _: f32) -> Bounds {
        Bounds::INFINITE
    }

    fn validate(&self) -> Option<NodeError> {
        // f² is at most cos²(y − z) + sin²(y + z) = 1 + sin 2y sin 2z.
        thickness_error(&self.cell, self.thickness.as_ref(), std::f32::consts::SQRT_2)
    }
}

/// Sines and cosines of a point's coordinates, scaled by 2π per cell.
fn cell_sin_cos<R: Real>(p: Vec3<R>, cell: &Length) -> (Vec3<R>, Vec3<R>) {
    let per_cell = p.x.uniform(1.0 / cell.get());
    let (sine_x, cosine_x) = (p.x * per_cell).sin_cos_turns();
    let (sine_y, cosine_y) = (p.y * per_cell).sin_cos_turns();
    let (sine_z, cosine_z) = (p.z * per_cell).sin_cos_turns();
    (vec3(sine_x, sine_y, sine_z), vec3(cosine_x, cosine_y, cosine_z))
}

/// Distance bound from `f`: of the side where it is negative, or of a wall around its zero set.
fn slab_around_zero<R: Real>(f: R, cell: &Length, thickness: Option<&Length>) -> R {
    let scale = f.uniform(cell.get() / (TAU * MAX_GRADIENT));
    match thickness {
        Some(thickness) => f.abs().mul_add(scale, -f.uniform(thickness.get() * 0.5)),
        None => f * scale,
    }
}

/// Error for a wall so thick that it fills all of space, because |f| never exceeds `greatest`.
fn thickness_error(cell: &Length, thickness: Option<&Length>, greatest: f32) -> Option<NodeError> {
    let most = cell.in_frame() * greatest / (PI * MAX_GRADIENT);
    thickness.filter(|thickness| thickness.in_frame() >= most).map(|_| {
        NodeError::new("thickness", format!("fills all of space: make thickness less than {most}, or cell larger"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distant_cells_are_bit_identical() {
        let cell = Length::new(0.5).expect("a length");
        let gyroid = Gyroid { cell: cell.clone(), thickness: None };
        let diamond = Diamond { cell, thickness: None };
        let p = vec3(0.125_f32, 0.062_5, 0.406_25);
        for cells in [1.0, 100.0, 200_000.0] {
            let away = vec3(p.x + cells * 0.5, p.y - cells * 0.5, p.z + cells);
            assert_eq!(gyroid.distance(p), gyroid.distance(away));
            assert_eq!(diamond.distance(p), diamond.distance(away));
        }
    }

    #[test]
    fn walls_just_below_the_maximum_thickness_leave_openings() {
        let cell = Length::new(1.0).expect("a length");
        let room = |most: f32| Length::new(most * 0.999);
        let most = 1.0 / (PI * MAX_GRADIENT);
        let gyroid = Gyroid { cell: cell.clone(), thickness: room(1.5 * most) };
        assert!(gyroid.validate().is_none() && gyroid.distance(vec3(0.125, 0.125, 0.125)) > 0.0);
        let schwarz = SchwarzP { cell: cell.clone(), thickness: room(3.0 * most) };
        assert!(schwarz.validate().is_none() && schwarz.distance(vec3(0.0, 0.0, 0.0)) > 0.0);
        let diamond = Diamond { cell, thickness: room(std::f32::consts::SQRT_2 * most) };
        assert!(diamond.validate().is_none() && diamond.distance(vec3(0.125, 0.125, 0.125)) > 0.0);
    }
}
