//! Where the nodes, objects and lights of a scene are written in its document.
//!
//! A scene to be rendered has no `use` and no groups: they are replaced when a job is parsed.

use std::collections::BTreeMap;

use crate::json_text;
use crate::nodes::Node;
use crate::scene::child_at;

/// The nodes of a valid document as written, each `use` still in its place.
#[derive(Clone, Debug, PartialEq)]
pub struct WrittenNodes {
    /// The objects' shapes.
    pub objects: Vec<Node>,
    /// The named shapes.
    pub shapes: BTreeMap<String, Node>,
    /// For each name of a shape that is itself a `use`, the name at the end of the chain.
    pub ends: BTreeMap<String, String>,
    /// Names of shapes that stand for a shape with numbers, with the name of that shape.
    pub instances: BTreeMap<String, String>,
    /// Where objects and lights of groups are written.
    pub groups: GroupPointers,
}

impl WrittenNodes {
    /// JSON pointer in the document's scene of a position in the scene, in which every `use` has been replaced.
    pub fn pointer(&self, in_scene: &str) -> String {
        let Some((mut node, start)) = self.root(in_scene) else { return self.groups.written(in_scene) };
        let (start, mut rest) = in_scene.split_at(start);
        let mut pointer = start.to_owned();
        loop {
            if let Some((name, shape)) = self.target(node) {
                let name = self.instances.get(name).map_or(name, String::as_str);
                pointer = format!("/shapes/{}", json_text::escape(name));
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
            "shapes" => self.shapes.get(&json_text::unescape(key))?,
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

/// Where the objects and lights of groups are in the document.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GroupPointers {
    /// For the pointers of a scene's objects and lights, those in the document, and the nodes added around a shape.
    pub moved: BTreeMap<String, Moved>,
}

/// Where an object or a light of a group is in the document.
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    /// JSON pointer in the document's scene.
    pub written: String,
    /// Names of the nodes around the shape, the outermost first, and the pointer of the group that each comes from.
    pub around: Vec<(&'static str, String)>,
}

impl GroupPointers {
    /// JSON pointer in the document's scene of a position in a scene whose groups have been replaced.
    pub fn written(&self, pointer: &str) -> String {
        let mut steps = pointer.match_indices('/').skip(2).map(|(start, _)| start);
        let end = steps.next().unwrap_or(pointer.len());
        let Some(moved) = self.moved.get(&pointer[..end]) else { return pointer.to_owned() };
        let Some(mut rest) = pointer[end..].strip_prefix("/shape") else {
            return format!("{}{}", moved.written, &pointer[end..]);
        };
        for (node, group) in &moved.around {
            let Some(inside) = rest.strip_prefix('/').and_then(|rest| rest.strip_prefix(node)) else { break };
            match inside.strip_prefix("/child") {
                Some(below) => rest = below,
                None => return format!("{group}{inside}"),
            }
        }
        format!("{}/shape{rest}", moved.written)
    }
}

/// The shape that a `use` stands for, and its name; a shape that is itself a `use` is followed to its end.
pub fn target<'n>(
    shapes: &'n BTreeMap<String, Node>,
    ends: &BTreeMap<String, String>,
    node: &Node,
) -> Option<(&'n str, &'n Node)> {
    let name = node.used_shape()?;
    let end = ends.get(name).map_or(name, String::as_str);
    shapes.get_key_value(end).map(|(name, shape)| (name.as_str(), shape))
}
