//! Counts the values that named shapes and groups have in the text, before either is copied to where it is used.

use std::borrow::Cow;
use std::collections::BTreeMap;

use crate::json::{Tree, Value};

/// Number of values of each named shape; a shape that it uses is not counted.
pub(super) fn shapes<'t>(tree: &'t Tree<'_>) -> BTreeMap<Cow<'t, str>, u64> {
    let shapes = tree.root().get("scene").and_then(|scene| scene.get("shapes"));
    shapes.into_iter().flat_map(Value::members).map(|(name, shape)| (name.string(), shape.span() as u64)).collect()
}

/// Number of values of the motion that all objects, lights and cameras of groups get from the groups around them.
pub(super) fn groups(tree: &Tree<'_>) -> u64 {
    let groups = tree.root().get("scene").and_then(|scene| scene.get("groups"));
    groups.map_or(0, |groups| inside(groups).1)
}

/// Number of things in groups, and of the values that they get.
fn inside(groups: Value<'_>) -> (u64, u64) {
    let (mut all_things, mut all_values) = (0_u64, 0_u64);
    for group in groups.entries() {
        let (mut things, mut own, mut values) = (1_u64, 0_u64, 0_u64);
        for (key, member) in group.members() {
            match key.raw() {
                "objects" | "lights" => things += member.entries().count() as u64,
                "groups" => {
                    let (inner, moved) = inside(member);
                    things += inner;
                    values = values.saturating_add(moved);
                }
                _ => own += member.span() as u64,
            }
        }
        all_things += things;
        all_values = all_values.saturating_add(values).saturating_add(own.saturating_mul(things));
    }
    (all_things, all_values)
}
