//! Named shapes: counts the nodes of a document, and finds positions in it.
//!
//! A `use` is replaced by its shape when a job is parsed, so a scene has none. Here are the nodes as written: their
//! sizes with every `use` replaced, and the position in the document of a position in the scene.

use std::collections::BTreeMap;

use crate::json_scan;
use crate::nodes::Node;
use crate::parse::GroupPointers;
use crate::scene::{base_pointer, child_at, child_pointers};

/// Size of a tree of nodes in which every `use` is replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TreeSize {
    /// Number of nodes; the largest number if there are more.
    pub nodes: u64,
    /// Nesting of the nodes.
    pub depth: usize,
}

impl TreeSize {
    /// Size of a node, given the sizes of the shapes that it uses. A `use` of any other shape counts as one node.
    pub(crate) fn of(node: &Node, shapes: &BTreeMap<&str, Self>) -> Self {
        if let Some(name) = node.used_shape() {
            return shapes.get(name).copied().unwrap_or(Self { nodes: 1, depth: 1 });
        }
        let sizes: Vec<Self> = node.children().iter().map(|child| Self::of(child, shapes)).collect();
        let nodes = node.nodes_in_children(&mut sizes.iter().map(|size| size.nodes));
        let base = node.base().map_or(Self { nodes: 0, depth: 0 }, |base| Self::of(base, shapes));
        let depth = sizes.iter().map(|size| size.depth).fold(base.depth, usize::max);
        Self { nodes: nodes.saturating_add(base.nodes).saturating_add(1), depth: depth.saturating_add(1) }
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

/// The nodes of a valid document as written, each `use` still in its place.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct WrittenNodes {
    /// The objects' shapes.
    pub objects: Vec<Node>,
    /// The named shapes.
    pub shapes: BTreeMap<String, Node>,
    /// See [`ends`].
    pub ends: BTreeMap<String, String>,
    /// Names of shapes that stand for a shape with numbers, with the name of that shape.
    pub instances: BTreeMap<String, String>,
    /// Where objects and lights of groups are written.
    pub groups: GroupPointers,
}

impl WrittenNodes {
    /// JSON pointer in the document's scene of a position in the scene, in which every `use` has been replaced.
    pub(crate) fn pointer(&self, in_scene: &str) -> String {
        let Some((mut node, start)) = self.root(in_scene) else { return self.groups.written(in_scene) };
        let (start, mut rest) = in_scene.split_at(start);
        let mut pointer = start.to_owned();
        loop {
            if let Some((name, shape)) = self.target(node) {
                let name = self.instances.get(name).map_or(name, String::as_str);
                pointer = format!("/shapes/{}", json_scan::escape(name));
                node = shape;
            }
            let Some((child, length)) = child_at(node, rest) else { return self.groups.written(&(pointer + rest)) };
            pointer.push_str(&rest[..length]);
            rest = &rest[length..];
            node = child;
        }
    }

    /// The root of the tree of a position, and the length of its JSON pointer.
    fn root(&self, pointer: &str) -> Option<(&Node, usize)> {
        let mut steps = pointer.split('/').skip(1);
        let (list, key) = (steps.next()?, steps.next()?);
        let node = match list {
            "objects" => self.objects.get(key.parse::<usize>().ok()?).filter(|_| steps.next() == Some("shape"))?,
            "shapes" => self.shapes.get(&json_scan::unescape(key))?,
            _ => return None,
        };
        let last = if list == "objects" { "/shape".len() } else { 0 };
        Some((node, 2 + list.len() + key.len() + last))
    }

    /// The shape that a `use` stands for, and its name; a shape that is itself a `use` is followed.
    fn target(&self, node: &Node) -> Option<(&str, &Node)> {
        target(&self.shapes, &self.ends, node)
    }
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

/// The shape that a `use` stands for, and its name; a shape that is itself a `use` is followed to its end.
pub(crate) fn target<'n>(
    shapes: &'n BTreeMap<String, Node>,
    ends: &BTreeMap<String, String>,
    node: &Node,
) -> Option<(&'n str, &'n Node)> {
    let name = node.used_shape()?;
    let end = ends.get(name).map_or(name, String::as_str);
    shapes.get_key_value(end).map(|(name, shape)| (name.as_str(), shape))
}
