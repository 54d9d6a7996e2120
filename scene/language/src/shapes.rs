//! Named shapes: counts the nodes of a document.
//!
//! A `use` is replaced by its shape when a job is parsed, so a scene has none. Here are the sizes of nodes with every
//! `use` replaced, and the order in which that is done.

use std::collections::BTreeMap;

use crate::nodes::Node;
use crate::scene::{base_pointer, child_pointers};

/// Size of a tree of nodes in which every `use` is replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TreeSize {
    /// Number of nodes; the largest number if there are more.
    pub nodes: u64,
    /// Nesting of the nodes.
    pub depth: usize,
    /// Values of the shapes that it uses, as [`MAX_VALUES`](crate::limits::MAX_VALUES) counts them.
    pub values: u64,
}

impl TreeSize {
    /// Size of a node, given the sizes of the shapes that it uses. A `use` of any other shape counts as one node.
    pub(crate) fn of(node: &Node, shapes: &BTreeMap<&str, Self>) -> Self {
        if let Some(name) = node.used_shape() {
            return shapes.get(name).copied().unwrap_or(Self { nodes: 1, depth: 1, values: 0 });
        }
        let sizes: Vec<Self> = node.children().iter().map(|child| Self::of(child, shapes)).collect();
        let nodes = node.nodes_in_children(&mut sizes.iter().map(|size| size.nodes));
        let base = node.base().map_or(Self { nodes: 0, depth: 0, values: 0 }, |base| Self::of(base, shapes));
        let values = sizes.iter().fold(base.values, |values, size| values.saturating_add(size.values));
        let depth = sizes.iter().map(|size| size.depth).fold(base.depth, usize::max);
        Self { nodes: nodes.saturating_add(base.nodes).saturating_add(1), depth: depth.saturating_add(1), values }
    }
}

/// Visits every `use` in a node: its JSON pointer, the name, and its nesting from 1.
pub(crate) fn each_use<'n>(
    node: &'n Node,
    pointer: &mut String,
    depth: usize,
    visit: &mut impl FnMut(&str, &'n str, usize),
) {
    if let Some(name) = node.used_shape() {
        visit(pointer, name, depth);
    }
    let length = pointer.len();
    for (child, step) in node.children().iter().zip(child_pointers(node)) {
        step.push_to(pointer);
        each_use(child, pointer, depth + 1, visit);
        pointer.truncate(length);
    }
    if let Some(base) = node.base() {
        pointer.push_str(&base_pointer(node));
        each_use(base, pointer, depth + 1, visit);
        pointer.truncate(length);
    }
}

/// The names of all shapes, each after those that it uses; or the names along a cycle, the first one again at its end.
pub(crate) fn in_order_of_use<'n>(shapes: &'n BTreeMap<String, Node>) -> Result<Vec<&'n str>, Vec<&'n str>> {
    let mut uses: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (name, shape) in shapes {
        let own = uses.entry(name).or_default();
        each_use(shape, &mut String::new(), 1, &mut |_, used, _| own.push(used));
    }
    let mut order = Vec::with_capacity(shapes.len());
    let mut is_done: BTreeMap<&str, bool> = BTreeMap::new();
    // A list instead of recursion, because a chain of shapes has any length.
    let mut open: Vec<(&'n str, std::slice::Iter<'_, &'n str>)> = Vec::new();
    for (&name, own) in &uses {
        if is_done.contains_key(name) {
            continue;
        }
        is_done.insert(name, false);
        open.push((name, own.iter()));
        while let Some((name, used)) = open.last_mut() {
            let Some(&next) = used.next() else {
                is_done.insert(name, true);
                order.push(*name);
                open.pop();
                continue;
            };
            match (is_done.get(next), uses.get(next)) {
                (None, Some(own)) => {
                    is_done.insert(next, false);
                    open.push((next, own.iter()));
                }
                (Some(false), _) => {
                    let cycle = open.iter().map(|&(name, _)| name).skip_while(|name| *name != next);
                    return Err(cycle.chain([next]).collect());
                }
                (Some(true), _) | (None, None) => {}
            }
        }
    }
    Ok(order)
}

/// For each name of a shape that is itself a `use`, the name at the end of the chain. `order` is that of
/// [`in_order_of_use`], so that every chain is followed in one step.
pub(crate) fn ends(shapes: &BTreeMap<String, Node>, order: &[&str]) -> BTreeMap<String, String> {
    let mut ends: BTreeMap<String, String> = BTreeMap::new();
    for &name in order {
        if let Some(next) = shapes.get(name).and_then(Node::used_shape) {
            let end = ends.get(next).map_or(next, String::as_str).to_owned();
            ends.insert(name.to_owned(), end);
        }
    }
    ends
}
