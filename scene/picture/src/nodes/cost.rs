//! Cost of evaluating a node, estimated from its tree.

use super::Node;

impl Node {
    /// Approximate cost in simple nodes, copies included; infinite for deeply nested copies.
    pub fn evaluation_cost(&self) -> f32 {
        let inside: f32 = self.children().iter().map(Self::evaluation_cost).sum();
        let own = self.size_in_nodes() as f32 + self.formula_cost();
        if inside == 0.0 { own } else { own + inside * self.child_evaluations() }
    }
}
