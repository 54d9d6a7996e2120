//! Smooth unions of any number of shapes: their order of combination, and their bounds.

use scene::nodes::Node;
use scene::real::vec3;

const SEAM: f32 = 0.5;

fn union_of(count: usize) -> Node {
    let balls = vec![r#"{ "sphere": { "radius": 1 } }"#; count].join(",");
    serde_json::from_str(&format!(r#"{{ "union": {{ "smooth": {SEAM}, "of": [{balls}] }} }}"#)).expect("a union")
}

/// Equal distances sink most. The first seam takes a quarter of its width; (1 − u)²/4 follows after u. Of groups of
/// unequal length, the short ones sink less.
#[test]
fn bounds_of_a_smooth_union_end_at_the_surface_of_equal_shapes() {
    for (count, most) in
        [(1, 0.0), (2, 0.0), (3, 0.0), (8, 0.0), (64, 0.0), (65, 0.3), (100, 0.1), (512, 0.0), (513, 0.3)]
    {
        let union = union_of(count);
        let end = union.bounds(0.0).max.x;
        let left = union.distance(vec3(end, 0.0, 0.0));
        assert!(
            (-2e-4..most * SEAM + 2e-4).contains(&left),
            "{count} shapes: from the bounds' end {end}, {left} is left"
        );
    }
}

#[test]
fn a_smooth_union_of_many_shapes_sinks_with_the_logarithm_of_their_number() {
    let sink = |count| (union_of(count).bounds(0.0).max.x - 1.0) / SEAM;
    assert!((sink(2) - 0.25).abs() < 1e-6);
    assert!((0.9..1.0).contains(&sink(64)), "a left fold sinks by less than a seam's width: {}", sink(64));
    for (count, depth) in [(512, 3.0), (4_096, 4.0), (32_768, 5.0)] {
        let per_group = sink(count) / depth;
        assert!((per_group - sink(8)).abs() < 1e-4, "{count} shapes: {per_group} of a width a group");
    }
}

/// A far shape changes nothing: its value and those of its neighbors are the ones of a shorter list.
#[test]
fn a_long_smooth_union_is_folded_in_groups_of_eight() {
    // The near ball is in the first group, its neighbor in the second: their seam is one between groups.
    let ball =
        |x: f32| format!(r#"{{ "translate": {{ "by": [{x}, 0, 0], "child": {{ "sphere": {{ "radius": 1 }} }} }} }}"#);
    let of = |places: &[f32]| {
        let balls: Vec<String> = places.iter().map(|x| ball(*x)).collect();
        let text = format!(r#"{{ "union": {{ "smooth": {SEAM}, "of": [{}] }} }}"#, balls.join(","));
        serde_json::from_str::<Node>(&text).expect("a union")
    };
    let mut places = [1e3_f32; 100];
    (places[7], places[8], places[9]) = (0.0, 0.4, 0.8);
    // From the left ((0, 0.4), 0.8); in groups (0, (0.4, 0.8)).
    let p = vec3(0.3, 1.2, 0.1);
    let from_the_left = of(&[0.0, 0.4, 0.8]).distance(p);
    let in_groups = of(&[0.4, 0.8, 0.0]).distance(p);
    assert_ne!(from_the_left.to_bits(), in_groups.to_bits(), "the point tells the orders apart");
    assert_eq!(of(&places).distance(p).to_bits(), in_groups.to_bits());
    assert_eq!(of(&places[..64]).distance(p).to_bits(), from_the_left.to_bits());
}
