//! Random formulas for the tests of tapes and of their back ends.

use std::sync::{Arc, LazyLock};

use scene::real::list::{IS_LAST, IS_UNARY, ListFunctions, NO_LEAF, ROW_BITS};
use scene::real::{FunctionKey, Real, Table, Vec3, Words};

/// Number of words of [`TABLE`] that are numbers.
const NUMBERS: u32 = 100;
/// A function and its row.
type Part = Option<[u32; 2]>;
/// Lists: of each operation, the function and row of its leaf, if it has one, then its join's.
const LISTS: [&[(Part, Part)]; 4] = [
    &[(Some([0, 5]), None)],
    &[(Some([1, 7]), None), (Some([0, 9]), Some([0, 20])), (Some([1, 30]), Some([0, 21]))],
    &[
        (Some([0, 11]), None),
        (Some([1, 12]), None),
        (Some([0, 13]), None),
        (Some([1, 14]), Some([0, 40])),
        (None, Some([1, 41])),
        (None, Some([0, 42])),
        (None, Some([0, 43])),
    ],
    &[(Some([1, 60]), None), (None, Some([1, 61])), (Some([0, 62]), Some([0, 63]))],
];

/// A table for formulas that read words: numbers from 0.5 to 1.5, then the indices of the lists, then these.
pub(crate) static TABLE: LazyLock<Table> = LazyLock::new(|| {
    let mut words: Vec<u32> =
        (0..NUMBERS).map(|index| (0.5 + (index * 37 % NUMBERS) as f32 / 100.0).to_bits()).collect();
    let mut lists = Vec::new();
    for list in LISTS {
        words.push(NUMBERS + LISTS.len() as u32 + lists.len() as u32);
        for (index, (leaf, join)) in list.iter().enumerate() {
            let last = if index + 1 == list.len() { IS_LAST } else { 0 };
            let leaf = leaf.map_or(NO_LEAF << ROW_BITS, |[function, row]| function << ROW_BITS | row);
            let join = join.map_or(0, |[function, row]| {
                (function + 1) << ROW_BITS | row | if function == 1 { IS_UNARY } else { 0 }
            });
            lists.extend([last | leaf, join]);
        }
    }
    words.extend(lists);
    // Room for a row after the last list.
    words.extend([0; 4]);
    Arc::new(Words::from(words))
});

/// Functions of the lists in [`TABLE`].
pub(crate) struct Functions;

impl<R: Real> ListFunctions<R> for Functions {
    type Value = (R, R);

    fn leaf_names(&self) -> &[&'static str] {
        &["leaf_0", "leaf_1"]
    }

    fn join_names(&self) -> &[&'static str] {
        &["join_0", "join_1"]
    }

    fn depth(&self) -> usize {
        3
    }

    fn leaf(&self, function: usize, row: Option<u32>, p: Vec3<R>) -> (R, R) {
        let (first, second) = (number(p.x, row, 0), number(p.x, row, 1));
        if function == 0 {
            return ((p.x * first).mul_add(p.y, second), p.z);
        }
        let inner = R::when(p.x.lt(p.y * first), p.z, || R::repeat(3, p.z, |z| (z.lt(p.x), z * second + 0.125)));
        (inner.abs().sqrt(), first)
    }

    fn join(&self, function: usize, row: Option<u32>, below: (R, R), value: (R, R)) -> (R, R) {
        let factor = number(value.0, row, 0);
        if function == 1 {
            return (value.0 * factor, value.1);
        }
        (below.0.min(value.0 * factor), R::select(value.0.lt(below.0), value.1, below.1))
    }
}

/// A word of a row, as a number.
fn number<R: Real>(like: R, row: Option<u32>, place: u32) -> R {
    like.uniform(row.map_or(0.0, |row| f32::from_bits(TABLE.get(row + place))))
}

/// Values of one of the lists.
pub(crate) fn fold<R: Real>(p: Vec3<R>) -> (R, R) {
    let list = R::word(&TABLE, (index_of(p.x) & (LISTS.len() as u32 - 1)) + NUMBERS);
    R::fold(&TABLE, list, p, &Functions)
}

/// An index from a number, sometimes beyond the table.
pub(crate) fn index_of<R: Real>(number: R) -> R::Bits {
    ((number + 0.0).to_bits() * 0x9e37_79b9) >> 25
}

/// Pseudo-random numbers (a linear congruential generator).
#[derive(Clone)]
pub(crate) struct Generator(pub(crate) u64);

impl Generator {
    pub(crate) fn word(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 32) as u32
    }

    pub(crate) fn below(&mut self, count: usize) -> usize {
        self.word() as usize % count
    }
}

/// A random formula: equal generators give equal formulas for every arithmetic. `depth` bounds its branches and loops.
pub(crate) fn random_formula<R: Real>(random: &mut Generator, given: &[R], depth: usize) -> R {
    let mut known = given.to_vec();
    for _ in 0..4 + random.below(12) {
        let [a, b, c] = std::array::from_fn(|_| known[random.below(known.len())]);
        let [d, e] = std::array::from_fn(|_| known[random.below(known.len())]);
        let number = random.below(100) as f32 / 32.0 - 1.5;
        let mask = match random.below(4) {
            0 => d.lt(e),
            1 => d.lt(e) & a.lt(b),
            2 => !d.below(number) | e.lt(a),
            // No lane, or all of them.
            _ => d.abs().below(if number < 0.0 { -1.0 } else { f32::MAX }),
        };
        let next = match random.below(if depth > 0 { 19 } else { 15 }) {
            0 => a + b,
            1 => a - b,
            2 => a * b,
            3 => a.mul_add(b, c),
            4 => a.mul_add(b.constant(number), c),
            5 => a.uniform(number).mul_add(b, c),
            6 => a.min(b),
            7 => a.max(b),
            8 => (a * number).floor(),
            9 => a.abs().sqrt(),
            10 => -a / (b.abs() + 0.5),
            11 => R::select(mask, a, b),
            // The sign of a zero is not defined.
            12 => {
                let mixed = ((a + 0.0).to_bits() ^ (b + 0.0).to_bits()) * 0x9e37_79b9;
                R::from_bits(((mixed >> 9) | 0x3f80_0000) & 0x3fff_ffff)
            }
            13 => a * a.constant(number),
            14 => a * R::from_bits(R::word(&TABLE, index_of(b))),
            15 | 16 => {
                let mut inner = random.clone();
                random.word();
                R::when(mask, a, || random_formula(&mut inner, &known, depth - 1))
            }
            17 => {
                let inner = random.clone();
                random.word();
                let step = |(x, y): (R, R)| {
                    let known: Vec<R> = known.iter().copied().chain([x, y]).collect();
                    let next = random_formula(&mut inner.clone(), &known, depth - 1);
                    // Lanes leave at different times, with exchanged state.
                    (next.lt(c) | mask, (y, next))
                };
                R::repeat(1 + (number.abs() * 4.0) as u32, (a, b), step).1
            }
            _ => {
                let (name, inner) =
                    (["step_of_0", "step_of_1", "step_of_2", "step_of_3"][depth], Generator(depth as u64));
                let body = |(x, y): (R, R)| random_formula(&mut inner.clone(), &[x, y], depth - 1);
                let key = FunctionKey::new(name);
                a.call(key, (a, b), body) + b.call(key, (b, c), body)
            }
        };
        // Small and no NaN, as in pictures.
        known.push(next.max(next.constant(-3.0)).min(next.constant(3.0)));
    }
    known[known.len() - 1]
}
