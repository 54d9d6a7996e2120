//! Dependencies of semantic errors: an error is certain only if no part that it depends on was replaced.

/// Whether an error at a pointer is certain, whatever replaced the values at the repaired pointers.
/// `has_use` tells of a pointer to a node whether named shapes are used in it.
pub(super) fn is_sure(pointer: &str, repaired: &[String], has_use: &dyn Fn(&str) -> bool) -> bool {
    let needed = needed(pointer, has_use);
    !repaired.iter().any(|repaired| needed.iter().any(|needed| needed.is_touched_by(repaired)))
}

/// A part that an error depends on.
struct Needed {
    pointer: String,
    /// Whether the error depends on all of the part's content too.
    is_whole: bool,
}

impl Needed {
    fn is_touched_by(&self, repaired: &str) -> bool {
        is_at_or_below(&self.pointer, repaired) || (self.is_whole && is_at_or_below(repaired, &self.pointer))
    }
}

/// Whether a pointer is equal to another one or below it.
fn is_at_or_below(pointer: &str, other: &str) -> bool {
    pointer.strip_prefix(other).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

fn needed(pointer: &str, has_use: &dyn Fn(&str) -> bool) -> Vec<Needed> {
    let whole = |pointer: &str| Needed { pointer: pointer.to_owned(), is_whole: true };
    let alone = |pointer: &str| Needed { pointer: pointer.to_owned(), is_whole: false };
    let steps: Vec<&str> = pointer.split('/').skip(1).collect();
    match steps.as_slice() {
        ["scene", "camera", ..] => vec![whole("/scene/camera"), whole("/frames")],
        ["scene", sky @ ("background" | "environment"), ..] => vec![whole(&format!("/scene/{sky}"))],
        ["scene", "lights", index, ..] => {
            vec![whole(&format!("/scene/lights/{index}")), whole("/scene/background"), whole("/scene/environment")]
        }
        ["scene", "objects", index, "shape", rest @ ..] => {
            of_node(pointer, format!("/scene/objects/{index}/shape"), rest, has_use)
        }
        ["scene", "shapes", name, rest @ ..] => of_node(pointer, format!("/scene/shapes/{name}"), rest, has_use),
        ["scene", "objects", _, "material"] => vec![whole(pointer), alone("/scene/materials")],
        ["image", "light_groups", ..] => {
            let parts = ["lights", "objects", "groups", "integrator"].map(|part| whole(&format!("/scene/{part}")));
            [whole("/image/light_groups"), alone("/image/format")].into_iter().chain(parts).collect()
        }
        ["image", "reweight_fireflies"] => vec![alone(pointer), whole("/image/samples"), whole("/scene/integrator")],
        ["image", "region", ..] => vec![whole(pointer), alone("/image/width"), alone("/image/height")],
        ["image", "layers" | "exposure" | "tone_map", ..] => {
            vec![whole(pointer), alone("/image/format"), alone("/image/layers")]
        }
        _ => vec![alone(pointer)],
    }
}

/// Parts that an error in a node depends on: its `pointer`, that of the outermost node, and the steps below that.
fn of_node(pointer: &str, mut node: String, mut rest: &[&str], has_use: &dyn Fn(&str) -> bool) -> Vec<Needed> {
    let whole = |pointer: &str| Needed { pointer: pointer.to_owned(), is_whole: true };
    let alone = |pointer: &str| Needed { pointer: pointer.to_owned(), is_whole: false };
    loop {
        let length = match rest {
            [_, "child" | "on", _, ..] => 2,
            [_, "of", place, _, ..] if place.parse::<usize>().is_ok() => 3,
            _ => break,
        };
        let (inside, below) = rest.split_at(length);
        for step in inside {
            node.push('/');
            node.push_str(step);
        }
        rest = below;
    }
    match rest {
        // A material by its name, or a medium.
        [_, "material"] => vec![whole(pointer), alone("/scene/materials")],
        [] => vec![alone(pointer)],
        // The node may use any shape.
        [..] if has_use(&node) => vec![whole(&node), whole("/scene/shapes")],
        [..] => vec![whole(&node)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sure(pointer: &str, repaired: &str) -> bool {
        is_sure(pointer, &[repaired.to_owned()], &|_| true)
    }

    #[test]
    fn errors_depend_on_related_repaired_numbers() {
        assert!(!sure("/scene/camera/look_at", "/scene/camera/position/0"));
        assert!(!sure("/scene/lights/1/sun", "/scene/background"));
        assert!(!sure("/scene/objects/0/shape/torus/tube", "/scene/objects/0/shape/torus/radius"));
        assert!(!sure("/scene/objects/0/shape/twist/child", "/scene/objects/0/shape/twist/child/box/size"));
        assert!(!sure("/scene/objects/0/material", "/scene/materials"));
        assert!(!sure("/scene/objects/0/shape/repeat/child", "/scene/shapes/leg/torus/tube"));
        assert!(!sure("/scene/shapes/leg/torus/tube", "/scene/shapes/leg/torus/radius"));
        assert!(!sure("/image/layers", "/image/format"));
        assert!(!sure("/image", "/image"));
    }

    #[test]
    fn errors_do_not_depend_on_unrelated_numbers() {
        assert!(sure("/scene/camera/look_at", "/scene/objects/0/shape"));
        assert!(sure("/scene/lights/1/sun", "/scene/lights/10"));
        assert!(sure("/scene/objects/0/material", "/scene/materials/clay/diffuse/kd"));
        let (inner, outer) = ("/scene/objects/0/shape/union/of/1", "/scene/objects/0/shape/union/of/0/torus/tube");
        assert!(sure(outer, inner));
        assert!(sure("/image/layers", "/image/width"));
        assert!(sure("/scene/objects/0/material", "/scene/objects/0/shape"));
        let of_other = ["/scene/shapes/leg".to_owned()];
        assert!(is_sure("/scene/objects/0/shape/torus/tube", &of_other, &|_| false));
    }
}
