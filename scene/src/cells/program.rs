//! A scene cut into leaves, and the operations above them in the order in which they are computed.

use std::collections::HashMap;

use super::trace::{Symbol, Trace, trace};
use crate::bounds::Bounds;
use crate::nodes::{Cut, Distance, Exactness, FoldStep, Node, Part, for_each_step, smooth_min};
use crate::real::{Interval, Real, Table, Vec3, vec3};
use crate::scene::Object;
use crate::values::LengthOrZero;

/// Maximum number of families: each is a function of the compiled text.
pub(super) const MAX_FAMILIES: usize = 48;
/// Words of a scene's table before its rows.
pub(super) const FIRST_WORDS: usize = 2;
/// Maximum number of values that wait for a join.
pub(super) const MAX_STACK: usize = 8;

/// A scene's leaves, their families and rows, and the operations above them.
#[derive(Clone, Debug)]
pub struct Program<'a> {
    leaves: Vec<Leaf<'a>>,
    /// A leaf of each family.
    families: Vec<usize>,
    joins: Vec<Join<'a>>,
    /// A join of each kind that occurs.
    join_families: Vec<usize>,
    operations: Vec<Operation>,
    depth: usize,
    /// First word of each leaf's row.
    leaf_rows: Vec<u32>,
    join_rows: Vec<u32>,
    /// The rows, after the first words of a scene's table.
    rows: Table,
}

/// A shape below the outermost joins.
#[derive(Clone, Debug)]
pub(super) struct Leaf<'a> {
    /// Transforms above the shape, the outermost first.
    above: Vec<&'a Node>,
    shape: Part<'a>,
    bounds: Bounds,
    /// Its Lipschitz factor, if one holds everywhere.
    lipschitz: Option<f32>,
    /// Index of its object.
    pub(super) object: usize,
    /// Index of its family.
    pub(super) family: usize,
    /// Its numbers.
    pub(super) numbers: Vec<u32>,
}

/// An operation on the values of leaves.
#[derive(Clone, Debug)]
pub(super) struct Join<'a> {
    pub(super) kind: JoinKind<'a>,
    pub(super) family: usize,
    pub(super) numbers: Vec<u32>,
}

/// Kind of a join.
#[derive(Clone, Copy, Debug)]
pub(super) enum JoinKind<'a> {
    /// The smooth or sharp minimum of two values.
    Union(&'a LengthOrZero),
    /// The lesser of two objects' values.
    Objects,
    /// A value by a factor.
    Scale(f32),
}

/// A step of a program: takes the value of a leaf, or the last value that waits, and joins it with the value that waits
/// before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Operation {
    pub(super) leaf: Option<u32>,
    pub(super) join: Option<u32>,
}

impl<'a> Program<'a> {
    /// Cuts objects, each with its index and the factor of its distance, at their outermost joins. `None` if the scene
    /// has too many families, or joins nested too deeply.
    pub fn new(objects: &[(usize, &'a Object, Option<f32>)]) -> Option<Self> {
        let mut cutter = Cutter::default();
        for (index, &(number, object, scale)) in objects.iter().enumerate() {
            cutter.object = number;
            let join = (index > 0).then_some(JoinKind::Objects);
            match scale {
                Some(scale) => {
                    cutter.cut(&object.shape, None);
                    cutter.join(JoinKind::Scale(scale));
                    if let Some(join) = join {
                        cutter.join(join);
                    }
                }
                None => cutter.cut(&object.shape, join),
            }
        }
        let depth = depth(&cutter.operations, &cutter.joins);
        let is_small = cutter.family_leaves.len() <= MAX_FAMILIES && depth <= MAX_STACK;
        // So that scenes of many and of more shapes have one text.
        let depth = if depth > 2 { MAX_STACK } else { depth };
        let mut words = vec![0; FIRST_WORDS];
        let mut row = |object: usize, numbers: &[u32]| {
            words.push((object as f32).to_bits());
            let start = words.len() as u32;
            words.extend(numbers);
            start
        };
        let leaf_rows = cutter.leaves.iter().map(|leaf| row(leaf.object, &leaf.numbers)).collect();
        let join_rows = cutter.joins.iter().map(|join| row(0, &join.numbers)).collect();
        (is_small && !cutter.operations.is_empty()).then_some(Self {
            leaf_rows,
            join_rows,
            rows: words.into(),
            leaves: cutter.leaves,
            families: cutter.family_leaves,
            joins: cutter.joins,
            join_families: cutter.family_joins,
            operations: cutter.operations,
            depth,
        })
    }

    /// Number of leaves.
    pub fn leaf_count(&self) -> usize {
        self.leaves.len()
    }

    /// Number of families.
    pub fn family_count(&self) -> usize {
        self.families.len()
    }

    /// The rows of all leaves and joins, where they are in the scene's table.
    pub fn rows(&self) -> &Table {
        &self.rows
    }

    /// Family of a leaf, and the first word of its row.
    pub fn family_and_row(&self, leaf: u32) -> (usize, u32) {
        (self.leaves[leaf as usize].family, self.leaf_rows[leaf as usize])
    }

    /// Family of a join, and the first word of its row.
    pub(super) fn join_family_and_row(&self, join: u32) -> (usize, u32) {
        (self.joins[join as usize].family, self.join_rows[join as usize])
    }

    /// Distance of the leaf of a family whose numbers are in a row of `table`.
    pub fn family_distance<R: Real>(&self, table: &Table, family: usize, row: R::Bits, p: Vec3<R>) -> R {
        let of_row = |row: u32| self.leaf_rows.binary_search(&row).expect("a row begins there");
        let leaf = R::known(row).map_or(self.families[family], of_row);
        R::with_row(table, row, || self.leaves[leaf].distance(p))
    }

    /// The join of a family whose numbers are in a row.
    pub(super) fn family_join<R: Real>(&self, family: usize, row: R::Bits) -> JoinKind<'a> {
        let of_row = |row: u32| self.join_rows.binary_search(&row).expect("a row begins there");
        self.joins[R::known(row).map_or(self.join_families[family], of_row)].kind
    }

    pub(super) fn leaves(&self) -> &[Leaf<'a>] {
        &self.leaves
    }

    pub(super) fn joins(&self) -> &[Join<'a>] {
        &self.joins
    }

    pub(super) fn join_families(&self) -> &[usize] {
        &self.join_families
    }

    pub(super) fn operations(&self) -> &[Operation] {
        &self.operations
    }

    /// Maximum number of values that wait for a join.
    pub(super) fn depth(&self) -> usize {
        self.depth
    }

    /// The value of all leaves at a point, without cells.
    pub fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let mut stack: Vec<R> = Vec::new();
        for operation in &self.operations {
            let value = match operation.leaf {
                Some(leaf) => self.leaves[leaf as usize].distance(p),
                None => stack.pop().expect("a value waits"),
            };
            let joined = match operation.join.map(|join| self.joins[join as usize].kind) {
                None => value,
                Some(JoinKind::Scale(by)) => JoinKind::Scale(by).apply(value, value),
                Some(kind) => kind.apply(stack.pop().expect("a value waits"), value),
            };
            stack.push(joined);
        }
        stack.pop().expect("a program has a value")
    }
}

impl Leaf<'_> {
    /// Its distance at a point of the scene.
    pub(super) fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let p = self.above.iter().fold(p, |p, node| node.to_child(p));
        self.shape.distance(p)
    }

    /// An interval that contains every distance in a box, given that at its center.
    pub(super) fn interval(&self, region: Bounds, at_center: f32) -> Interval {
        /// Rounding errors of distances and coordinates, as a part of their size.
        const ROUNDING: f32 = 1.0 / 65_536.0;
        let size =
            [region.min, region.max].map(|corner| corner.map(f32::abs).max_element()).into_iter().fold(0.0, f32::max);
        let Some(lipschitz) = self.lipschitz else {
            // Nothing bounds its change, but outside of the bounds of a level, values are above that level.
            let gap = self.bounds.gap(region);
            let levels = [0.9, 0.5, 0.1].map(|part| gap * part);
            let is_above =
                |level: &f32| *level > 0.0 && self.bounds_of(*level).with_margin(region.min).gap(region) > 0.0;
            let low = levels.into_iter().find(is_above).unwrap_or(f32::NEG_INFINITY);
            return Interval::new(low, f32::INFINITY);
        };
        let change = lipschitz * 0.5 * region.diagonal() + ROUNDING * (size + at_center.abs());
        Interval::new(at_center - change, at_center + change)
    }

    /// Box that contains every point of its shape.
    pub(super) fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Box that contains every point whose distance is at most `isolevel`.
    fn bounds_of(&self, isolevel: f32) -> Bounds {
        self.above.iter().rev().fold(self.shape.bounds(isolevel), |bounds, node| node.bounds_from_child(bounds))
    }
}

impl JoinKind<'_> {
    /// Joins the value that waits, and the new one. A factor applies to the new one.
    pub(super) fn apply<R: Real>(self, below: R, value: R) -> R {
        match self {
            Self::Union(smooth) => smooth_min(Distance(below), Distance(value), smooth).0,
            Self::Objects => below.min(value),
            Self::Scale(by) => value * value.uniform(by),
        }
    }

    /// Whether it takes one value, and not one that waits.
    pub(super) fn is_unary(self) -> bool {
        matches!(self, Self::Scale(_))
    }

    /// Width within which two values change each other.
    pub(super) fn width(self) -> f32 {
        match self {
            Self::Union(smooth) => smooth.get(),
            Self::Objects | Self::Scale(_) => 0.0,
        }
    }

    /// All values of the join of two intervals.
    pub(super) fn apply_to_intervals(self, below: Interval, value: Interval) -> Interval {
        match self {
            // A smooth minimum grows with either value, but for rounding.
            Self::Union(smooth) if !smooth.is_zero() => {
                let [low, high] = [(below.low, value.low), (below.high, value.high)].map(|(a, b)| {
                    let slack = 4.0 * f32::EPSILON * (a.abs() + b.abs() + smooth.get());
                    (self.apply(a, b), slack)
                });
                Interval::new(low.0 - low.1, high.0 + high.1)
            }
            Self::Union(_) | Self::Objects | Self::Scale(_) => self.apply(below, value),
        }
    }
}

/// Number of values that wait for a join, at most.
fn depth(operations: &[Operation], joins: &[Join<'_>]) -> usize {
    let (mut waiting, mut most) = (0_usize, 0);
    for operation in operations {
        let is_binary = operation.join.is_some_and(|join| !joins[join as usize].kind.is_unary());
        waiting = waiting + usize::from(operation.leaf.is_some()) - usize::from(is_binary);
        most = most.max(waiting);
    }
    most
}

#[derive(Default)]
struct Cutter<'a> {
    /// Index of the object that is cut.
    object: usize,
    above: Vec<&'a Node>,
    leaves: Vec<Leaf<'a>>,
    joins: Vec<Join<'a>>,
    operations: Vec<Operation>,
    texts: HashMap<Vec<u32>, usize>,
    family_leaves: Vec<usize>,
    join_texts: HashMap<Vec<u32>, usize>,
    join_rows: HashMap<(usize, Vec<u32>), u32>,
    family_joins: Vec<usize>,
}

impl<'a> Cutter<'a> {
    /// Adds the operations of a node, whose value is then joined with the one before.
    fn cut(&mut self, node: &'a Node, join: Option<JoinKind<'a>>) {
        match node.cut() {
            Cut::Leaf => self.leaf(Part::Shape(node), join),
            Cut::Child(child) => {
                self.above.push(node);
                self.cut(child, join);
                self.above.pop();
            }
            Cut::Union(smooth, parts) => {
                let seam = JoinKind::Union(smooth);
                if let [only] = parts[..] {
                    return self.part(only, join);
                }
                for_each_step(&parts, smooth, |step| match step {
                    FoldStep::First(part) => self.part(part, None),
                    FoldStep::Next(part) => self.part(part, Some(seam)),
                    FoldStep::Join => self.join(seam),
                });
                if let Some(join) = join {
                    self.join(join);
                }
            }
        }
    }

    fn part(&mut self, part: Part<'a>, join: Option<JoinKind<'a>>) {
        match part {
            Part::Shape(shape) => self.cut(shape, join),
            Part::Copy(..) => self.leaf(part, join),
        }
    }

    fn leaf(&mut self, shape: Part<'a>, join: Option<JoinKind<'a>>) {
        let (above, bounds) = (self.above.clone(), Bounds::INFINITE);
        let lipschitz = (shape.node().exactness() != Exactness::Estimate).then(|| shape.node().stretch());
        let mut leaf = Leaf { above, shape, bounds, lipschitz, object: self.object, family: 0, numbers: Vec::new() };
        leaf.bounds = leaf.bounds_of(0.0);
        let Trace { text, numbers, .. } = trace(|[x, y, z]: [Symbol; 3]| {
            leaf.distance(vec3(x, y, z));
        });
        let next = self.family_leaves.len();
        leaf.family = *self.texts.entry(text).or_insert(next);
        leaf.numbers = numbers;
        if leaf.family == next {
            self.family_leaves.push(self.leaves.len());
        }
        self.leaves.push(leaf);
        let join = join.map(|kind| self.joined(kind));
        self.operations.push(Operation { leaf: Some(self.leaves.len() as u32 - 1), join });
    }

    fn join(&mut self, kind: JoinKind<'a>) {
        let join = self.joined(kind);
        self.operations.push(Operation { leaf: None, join: Some(join) });
    }

    /// Index of a join; equal joins are one.
    fn joined(&mut self, kind: JoinKind<'a>) -> u32 {
        let Trace { text, numbers, .. } = trace(|[below, value]: [Symbol; 2]| {
            kind.apply(below, value);
        });
        let next = self.family_joins.len();
        let family = *self.join_texts.entry(text).or_insert(next);
        if family == next {
            self.family_joins.push(self.joins.len());
        }
        let joins = &mut self.joins;
        *self.join_rows.entry((family, numbers)).or_insert_with_key(|(_, numbers)| {
            joins.push(Join { kind, family, numbers: numbers.clone() });
            joins.len() as u32 - 1
        })
    }
}
