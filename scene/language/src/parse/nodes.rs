//! Validates the nodes of a document, and replaces each `use` by the shape of its name.
//!
//! Everything is counted first, so that nothing is copied that would exceed a limit.

use std::collections::{BTreeMap, BTreeSet};

use super::{MAX_ERRORS, SemanticErrors, placed, suggest};
use crate::document::{NamedShapes, SceneDocument};
use crate::json::Tree;
use crate::json_text::escape;
use crate::kinds::NodeError;
use crate::limits::{MAX_NODE_DEPTH, MAX_NODES, MAX_PLACING_COST, MAX_VALUES};
use crate::nodes::Node;
use crate::scene::{base_pointer, child_pointers};
use crate::shapes::{TreeSize, each_use, ends, in_order_of_use};
use crate::written::{GroupPointers, WrittenNodes, target};

/// Maximum number of nodes, with their copies, that are evaluated for errors in a scene that has too many.
const MAX_EVALUATED_NODES: u64 = 4 * MAX_NODES as u64;
/// Maximum number of names listed in a message about a cycle.
const MAX_LISTED: usize = 8;

/// Validates all nodes of the scene of a tree, and replaces each `use` in its objects.
pub(super) fn expand(
    scene: &mut SceneDocument,
    tree: &Tree<'_>,
    groups: &GroupPointers,
    faults: &mut SemanticErrors,
) -> NamedShapes {
    let shapes = std::mem::take(&mut scene.shapes);
    unknown_uses(scene, &shapes, faults);
    let limits = limits(scene, tree, &shapes, faults);
    let ends = ends(&shapes, &limits.order);
    let mut expansion = Expansion {
        shapes: &shapes,
        ends: &ends,
        limits,
        is_valid: BTreeMap::new(),
        used: BTreeSet::new(),
        placing_cost: 0.0,
        nodes_left: MAX_EVALUATED_NODES,
        faults,
    };
    let has_own_pointers = !shapes.is_empty() || *groups != GroupPointers::default();
    let written = has_own_pointers.then(|| scene.objects.iter().map(|object| object.shape.clone()).collect());
    for (index, object) in scene.objects.iter_mut().enumerate() {
        expansion.node(&mut object.shape, &mut Some(format!("/scene/objects/{index}/shape")), 1);
    }
    let unused_names = shapes.keys().filter(|name| !expansion.used.contains(name.as_str())).cloned().collect();
    let unused = expansion.unused();
    let written = written.map(|objects| WrittenNodes {
        objects,
        shapes,
        ends,
        instances: BTreeMap::new(),
        groups: groups.clone(),
    });
    NamedShapes { written, unused_names, unused }
}

/// Reports each `use` of a name that is not defined.
fn unknown_uses(scene: &SceneDocument, shapes: &BTreeMap<String, Node>, faults: &mut SemanticErrors) {
    let objects = scene.objects.iter().enumerate();
    let objects = objects.map(|(index, object)| (format!("/scene/objects/{index}/shape"), &object.shape));
    let named = shapes.iter().map(|(name, shape)| (format!("/scene/shapes/{}", escape(name)), shape));
    let known: Vec<&str> = shapes.keys().map(String::as_str).collect();
    for (mut pointer, node) in objects.chain(named).filter(|(_, node)| has_use(node)) {
        each_use(node, &mut pointer, 1, &mut |pointer, name, _| {
            if !shapes.contains_key(name) && faults.len() < MAX_ERRORS {
                faults.push((format!("{pointer}/use"), suggest::unknown_shape(name, &known)));
            }
        });
    }
}

/// Whether a node, or one in it, is a `use`: faster than visiting each with its pointer.
fn has_use(node: &Node) -> bool {
    node.used_shape().is_some() || node.children().iter().chain(node.base()).any(has_use)
}

/// Sizes of the shapes, and whether they are within the limits.
#[derive(Clone, Debug)]
struct Limits<'s> {
    /// Names of the shapes, each after those that it uses; empty if no `use` can be replaced.
    order: Vec<&'s str>,
    /// Sizes of the shapes.
    sizes: BTreeMap<&'s str, TreeSize>,
    /// Whether each `use` can be replaced by its shape.
    can_replace: bool,
    /// Whether nodes can be evaluated: they are not, if copies make more than a scene may have.
    can_evaluate: bool,
}

/// Reports cycles of shapes, and shapes and objects that are too large once each `use` is replaced.
fn limits<'s>(
    scene: &SceneDocument,
    tree: &Tree<'_>,
    shapes: &'s BTreeMap<String, Node>,
    faults: &mut SemanticErrors,
) -> Limits<'s> {
    let own_values = placed::shapes(tree);
    let mut limits = Limits { order: Vec::new(), sizes: BTreeMap::new(), can_replace: true, can_evaluate: true };
    match in_order_of_use(shapes) {
        Ok(order) => limits.order = order,
        Err(cycle) => {
            faults.push(cycle_fault(shapes, &cycle));
            limits.can_replace = false;
        }
    }
    for &name in &limits.order {
        let mut size = TreeSize::of(&shapes[name], &limits.sizes);
        // A shape that is a use of another is not copied itself.
        if shapes[name].used_shape().is_none() {
            size.values = size.values.saturating_add(own_values.get(name).copied().unwrap_or_default());
        }
        let pointer = format!("/scene/shapes/{}", escape(name));
        limits.can_replace &= !nests_too_deep(&shapes[name], &pointer, size, &limits.sizes, faults);
        if let Some(fault) = too_many_copies(&shapes[name], size, pointer.clone(), &limits.sizes) {
            faults.push(fault);
            limits.can_replace = false;
        } else if size.nodes > MAX_NODES as u64 {
            let message =
                format!("has {} nodes, counting those of the shapes in it: use at most {MAX_NODES}", size.nodes);
            faults.push((pointer, message));
            limits.can_replace = false;
        } else if size.values > MAX_VALUES {
            faults.push((pointer, too_many_values(size.values)));
            limits.can_replace = false;
        }
        if !limits.can_replace {
            // A shape around this one would exceed the limit, too.
            return limits;
        }
        limits.sizes.insert(name, size);
    }
    let (mut nodes, mut written, mut values, mut copies_fault) = (0_u64, 0_u64, 0_u64, None);
    for (index, object) in scene.objects.iter().enumerate() {
        let size = TreeSize::of(&object.shape, &limits.sizes);
        let pointer = format!("/scene/objects/{index}/shape");
        limits.can_replace &= !nests_too_deep(&object.shape, &pointer, size, &limits.sizes, faults);
        copies_fault = copies_fault.or_else(|| too_many_copies(&object.shape, size, pointer, &limits.sizes));
        nodes = nodes.saturating_add(size.nodes);
        values = values.saturating_add(size.values);
        written = written.saturating_add(written_nodes(&object.shape));
    }
    if nodes > MAX_NODES as u64 {
        let counted = if nodes > written { ", counting each use of a shape and each copy" } else { "" };
        let in_all = || ("/scene/objects".to_owned(), format!("has {nodes} nodes{counted}: use at most {MAX_NODES}"));
        faults.push(copies_fault.unwrap_or_else(in_all));
        limits.can_replace = false;
        limits.can_evaluate = nodes == written;
    } else if values > MAX_VALUES {
        faults.push(("/scene/objects".to_owned(), too_many_values(values)));
        limits.can_replace = false;
    }
    limits
}

fn too_many_values(values: u64) -> String {
    format!(
        "has {values} values, counting those of a shape for each use of it: use at most {MAX_VALUES}, with fewer keys or fewer uses"
    )
}

/// Error for the innermost node in a node of this size whose copies alone are more nodes than a scene may have.
fn too_many_copies(
    node: &Node,
    size: TreeSize,
    mut pointer: String,
    sizes: &BTreeMap<&str, TreeSize>,
) -> Option<(String, String)> {
    if size.nodes <= MAX_NODES as u64 || node.used_shape().is_some() {
        return None;
    }
    let children: Vec<TreeSize> = node.children().iter().map(|child| TreeSize::of(child, sizes)).collect();
    if let Some(large) = children.iter().position(|child| child.nodes > MAX_NODES as u64) {
        child_pointers(node).skip(large).take(1).for_each(|step| step.push_to(&mut pointer));
        return too_many_copies(&node.children()[large], children[large], pointer, sizes);
    }
    let once = children.iter().fold(0, |nodes: u64, child| nodes.saturating_add(child.nodes));
    let copied = node.nodes_in_children(&mut children.iter().map(|child| child.nodes));
    (copied > once).then(|| {
        let nodes = size.nodes;
        let message = format!(
            "makes {nodes} nodes of its copies: use fewer copies, because a scene has at most {MAX_NODES} nodes"
        );
        (format!("{pointer}/{}", node.name()), message)
    })
}

fn written_nodes(node: &Node) -> u64 {
    1 + node.children().iter().chain(node.base()).map(written_nodes).sum::<u64>()
}

/// Reports each `use` whose shape nests too deep where it is used.
fn nests_too_deep(
    node: &Node,
    pointer: &str,
    size: TreeSize,
    sizes: &BTreeMap<&str, TreeSize>,
    faults: &mut SemanticErrors,
) -> bool {
    let mut is_too_deep = false;
    if size.depth > MAX_NODE_DEPTH {
        each_use(node, &mut pointer.to_owned(), 1, &mut |pointer, name, depth| {
            let depth = depth - 1 + sizes.get(name).map_or(0, |size| size.depth);
            if depth > MAX_NODE_DEPTH {
                let message =
                    format!("nests {depth} nodes deep, with those of the shape: nest at most {MAX_NODE_DEPTH}");
                faults.push((format!("{pointer}/use"), message));
                is_too_deep = true;
            }
        });
    }
    is_too_deep
}

/// Error for shapes that use each other in a cycle, at the last `use` of it.
fn cycle_fault(shapes: &BTreeMap<String, Node>, cycle: &[&str]) -> (String, String) {
    let [.., last, first] = cycle else { return (String::new(), String::new()) };
    let mut pointer = None;
    each_use(&shapes[*last], &mut format!("/scene/shapes/{}", escape(last)), 1, &mut |place, name, _| {
        if name == *first {
            pointer.get_or_insert(format!("{place}/use"));
        }
    });
    let mut path: Vec<String> = cycle.iter().take(MAX_LISTED).map(|name| format!("\"{name}\"")).collect();
    if cycle.len() > MAX_LISTED {
        path.push(format!("… → \"{first}\""));
    }
    let message = format!("makes \"{first}\" a part of itself ({}): remove one of these uses", path.join(" → "));
    (pointer.unwrap_or_default(), message)
}

/// Validation of nodes, in which each `use` is replaced.
struct Expansion<'s, 'f> {
    shapes: &'s BTreeMap<String, Node>,
    /// See [`ends`].
    ends: &'s BTreeMap<String, String>,
    limits: Limits<'s>,
    /// Whether a shape is valid, once it has been validated.
    is_valid: BTreeMap<&'s str, bool>,
    /// Names of the shapes that are used by an object.
    used: BTreeSet<&'s str>,
    /// See [`MAX_PLACING_COST`].
    placing_cost: f32,
    /// Nodes, with their copies, that may still be evaluated in a scene that has too many.
    nodes_left: u64,
    faults: &'f mut SemanticErrors,
}

impl Expansion<'_, '_> {
    /// Replaces each `use` in a node, and validates the nodes if their JSON `pointer` is given. Returns whether they
    /// are valid, so that their bounds may be computed. Errors inside a node are reported first, because a node can be
    /// validated only if its children are valid.
    fn node(&mut self, node: &mut Node, pointer: &mut Option<String>, depth: usize) -> bool {
        if node.used_shape().is_some() {
            return self.replace(node);
        }
        let Some(at) = pointer else {
            for child in node.children_mut() {
                self.node(child, &mut None, depth + 1);
            }
            if let Some(base) = node.base_mut() {
                self.node(base, &mut None, depth + 1);
            }
            return self.can_place(node, || "/scene/shapes".to_owned());
        };
        if depth == MAX_NODE_DEPTH + 1 {
            self.faults.push((at.clone(), format!("nests {depth} nodes deep: nest at most {MAX_NODE_DEPTH}")));
        }
        let mut is_sound = true;
        let length = at.len();
        let steps = child_pointers(node);
        for (child, step) in node.children_mut().iter_mut().zip(steps) {
            if let Some(at) = pointer {
                step.push_to(at);
            }
            is_sound &= self.node(child, pointer, depth + 1);
            if let Some(at) = pointer {
                at.truncate(length);
            }
        }
        let step = node.base().map(|_| base_pointer(node));
        if let (Some(base), Some(step), Some(at)) = (node.base_mut(), step, pointer.as_mut()) {
            at.push_str(&step);
            is_sound &= self.node(base, pointer, depth + 1);
        }
        if let Some(at) = pointer {
            at.truncate(length);
        }
        let at = pointer.as_deref().unwrap_or_default();
        self.validate(node, at, is_sound)
    }

    /// Validates a node whose children have been validated.
    fn validate(&mut self, node: &Node, pointer: &str, are_children_sound: bool) -> bool {
        let name = node.name();
        if node.has_child_list() && node.children().is_empty() {
            self.faults.push((format!("{pointer}/{name}/of"), format!("is empty: {name} needs a shape or more")));
            return false;
        }
        let in_base = || format!("{pointer}{}", base_pointer(node));
        if !are_children_sound || !self.can_evaluate(node) || !self.can_place(node, in_base) {
            return false;
        }
        match node.validate() {
            Some(NodeError { pointer: place, message }) => {
                self.faults.push((format!("{pointer}/{name}/{place}"), message));
                false
            }
            None => true,
        }
    }

    /// Whether a node is small enough to be evaluated.
    fn can_evaluate(&mut self, node: &Node) -> bool {
        if self.limits.can_evaluate {
            return true;
        }
        let nodes = TreeSize::of(node, &self.limits.sizes).nodes;
        let is_small = nodes <= self.nodes_left.min(MAX_NODES as u64);
        self.nodes_left -= if is_small { nodes } else { 0 };
        is_small
    }

    /// Whether the copies that a node scatters can be placed within the scene's limit. Reports the first that cannot.
    fn can_place(&mut self, node: &Node, pointer: impl FnOnce() -> String) -> bool {
        let (before, cost) = (self.placing_cost, node.placing_cost());
        self.placing_cost += cost;
        if before <= MAX_PLACING_COST && self.placing_cost > MAX_PLACING_COST {
            let message = format!(
                "takes too long to place copies on: use fewer copies, or a simpler shape; the copies, each times the nodes under it, may be {MAX_PLACING_COST:e} in a scene"
            );
            self.faults.push((pointer(), message));
        }
        cost == 0.0 || self.placing_cost <= MAX_PLACING_COST
    }

    /// Replaces a `use` by its shape. Returns whether the shape is valid.
    fn replace(&mut self, node: &mut Node) -> bool {
        self.note_use(node);
        let target = self.limits.can_replace.then(|| target(self.shapes, self.ends, node)).flatten();
        let Some((name, shape)) = target else { return false };
        let mut shape = shape.clone();
        let known = self.is_valid.get(name).copied();
        let is_valid = if let Some(is_valid) = known {
            self.node(&mut shape, &mut None, 1);
            is_valid
        } else {
            let is_valid = self.node(&mut shape, &mut Some(format!("/scene/shapes/{}", escape(name))), 1);
            self.is_valid.insert(name, is_valid);
            is_valid
        };
        *node = shape;
        is_valid
    }
}

impl<'s> Expansion<'s, '_> {
    /// Marks the shapes that a `use` names: more than one if a shape is itself a `use`.
    fn note_use(&mut self, node: &Node) {
        let mut next = node.used_shape();
        while let Some((name, shape)) = next.and_then(|name| self.shapes.get_key_value(name)) {
            if !self.used.insert(name) {
                return;
            }
            next = shape.used_shape();
        }
    }

    /// Validates the shapes that no object uses. Returns those that are in no other shape, each `use` replaced.
    fn unused(&mut self) -> Vec<(String, Node)> {
        let names: Vec<&'s str> = if self.limits.can_replace {
            self.limits.order.iter().rev().copied().collect()
        } else {
            self.shapes.keys().map(String::as_str).collect()
        };
        let (mut unused, mut nodes) = (Vec::new(), 0_u64);
        for name in names {
            let shape = &self.shapes[name];
            if self.is_valid.contains_key(name) || shape.used_shape().is_some() {
                continue;
            }
            nodes = nodes.saturating_add(self.limits.sizes.get(name).map_or(0, |size| size.nodes));
            if self.limits.can_replace && nodes > MAX_NODES as u64 {
                let message = format!("has more than {MAX_NODES} nodes that no object uses: remove unused shapes");
                self.faults.push(("/scene/shapes".to_owned(), message));
                break;
            }
            let mut shape = shape.clone();
            let is_valid = self.node(&mut shape, &mut Some(format!("/scene/shapes/{}", escape(name))), 1);
            self.is_valid.insert(name, is_valid);
            unused.push((name.to_owned(), shape));
        }
        unused
    }
}
