//! Estimated cost of evaluating a node, without evaluating it.

use super::{Exactness, Node};

/// Cost of noise at a point, in simple nodes.
const NOISE: f32 = 20.0;
/// Cost of a fractal.
const FRACTAL: f32 = 32.0;

impl Node {
    /// Approximate cost in simple nodes, copies included; infinite for deeply nested copies.
    pub(crate) fn work(&self) -> f32 {
        let inside: f32 = self.children().iter().map(Self::work).sum();
        let own = self.weight() as f32 + self.formula();
        if inside == 0.0 { own } else { own + inside * self.looks() }
    }

    /// Cost of its own formula beyond that of a simple node.
    fn formula(&self) -> f32 {
        if let Self::Warp(_) = self {
            return 3.0 * NOISE;
        }
        if matches!(self, Self::Displace(_) | Self::HeightField(_)) {
            return NOISE;
        }
        let is_fractal = self.children().is_empty() && self.exactness() == Exactness::Estimate;
        if is_fractal { FRACTAL } else { 0.0 }
    }

    /// Number of evaluations of its children.
    fn looks(&self) -> f32 {
        if let Self::Repeat(repeat) = self {
            return repeat.looks();
        }
        if let Self::PolarRepeat(repeat) = self {
            return repeat.looks();
        }
        if let Self::Mirror(_) = self { 2.0 } else { 1.0 }
    }
}
