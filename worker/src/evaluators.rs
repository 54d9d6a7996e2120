//! Tests that every back end of the CPU gives the reference's bits.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use scene::real::{FunctionKey, MaskValue, Real, vec3};
use tape::{Evaluator, Expr, Simd, Tape, record};

use crate::cells::FastBuilder;
use crate::picture_tape::record_picture;
use crate::random_formula::{Generator, TABLE, fold, index_of, random_formula};

mod c_text;
pub(crate) mod cells;

pub(super) const ENTRY: &str = "entry";

/// A formula of three numbers, and its value by the reference.
pub(super) struct Formula {
    pub(super) name: String,
    pub(super) tape: Tape,
    pub(super) reference: Box<dyn Fn([f32; 3]) -> f32>,
}

impl Formula {
    fn new(name: &str, formula: impl Fn([Expr; 3]) -> Expr, reference: impl Fn([f32; 3]) -> f32 + 'static) -> Self {
        let tape = record(|recording| recording.entry(ENTRY, |all: [Expr; 3]| vec![formula(all)]));
        Self { name: name.to_owned(), tape, reference: Box::new(reference) }
    }

    /// Asserts that this is the reference's value.
    pub(super) fn assert_equal(&self, evaluator: &str, given: [f32; 3], got: f32) {
        let want = (self.reference)(given);
        assert_eq!(
            (got + 0.0).to_bits(),
            (want + 0.0).to_bits(),
            "{} by {evaluator} of {given:?}: {got} for {want}",
            self.name
        );
    }
}

/// Pseudo-random arguments from -2 to 2, in three rows of this length.
pub(super) fn arguments(random: &mut Generator, length: usize) -> Vec<f32> {
    (0..3 * length).map(|_| random.word() as f32 / (1 << 30) as f32 - 2.0).collect()
}

/// Evaluates a formula everywhere, and compares it with the reference.
fn compare(formula: &Formula) {
    compare_packets(formula, 20);
}

/// The same for a number of packets of each evaluator.
fn compare_packets(formula: &Formula, packets: usize) {
    let tape = &formula.tape;
    let mut random = Generator(1);
    for (simd, evaluator) in Evaluator::each(tape).expect("a recorded tape is valid") {
        let (inputs, mut frame) = (evaluator.inputs(tape), evaluator.frame());
        let (lanes, cancel) = (evaluator.lanes(), AtomicBool::new(false));
        for _ in 0..packets {
            let arguments = arguments(&mut random, lanes);
            let mut results = vec![0.0; lanes];
            evaluator.run(ENTRY, &mut frame, &inputs, &cancel, &arguments, &mut results);
            for (lane, &result) in results.iter().enumerate() {
                formula.assert_equal(simd, [0, 1, 2].map(|place| arguments[place * lanes + lane]), result);
            }
        }
    }
}

pub(super) fn random_formulas() -> Vec<Formula> {
    let of_seed = |seed: u64| {
        let depth = (seed % 4) as usize;
        Formula::new(
            &format!("formula {seed}"),
            |all| random_formula(&mut Generator(seed), &all, depth),
            move |all| random_formula(&mut Generator(seed), &all, depth),
        )
    };
    (0..300).map(of_seed).collect()
}

#[test]
fn random_formulas_give_the_reference_bits() {
    random_formulas().iter().for_each(compare);
}

macro_rules! formulas {
    ($($name:literal: |$a:ident, $b:ident, $c:ident| $formula:expr;)*) => { vec![$(
        {
            fn formula<R: Real>([$a, $b, $c]: [R; 3]) -> R {
                let _ = ($a, $b, $c);
                $formula
            }
            Formula::new($name, formula::<Expr>, formula::<f32>)
        },
    )*] };
}

/// The tape of a shipped picture.
fn picture(path: &Path) -> Tape {
    let job = scene::parse(&std::fs::read(path).expect("a job file")).expect("a valid job");
    record_picture(&job.at(0).expect("a valid frame"), &FastBuilder::UNLIMITED)
}

#[test]
fn pictures_of_all_shipped_scenes_are_valid() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes");
    for entry in std::fs::read_dir(folder).expect("the scenes are there") {
        let path = entry.expect("a folder can be read").path();
        if path.extension().is_some_and(|extension| extension == "json") {
            let tape = picture(&path);
            let start = Instant::now();
            let found = tape.verify().err();
            assert_eq!(found, None, "{}", path.display());
            println!("{}: verified in {:?}", path.display(), start.elapsed());
        }
    }
}

#[test]
fn the_machine_code_of_every_shipped_scene_is_small() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes");
    println!("| Scene | Recorded, ms | Compiled, ms | Size, KiB |\n|---|---|---|---|");
    for entry in std::fs::read_dir(folder).expect("the scenes are there") {
        let path = entry.expect("a folder can be read").path();
        if path.extension().is_none_or(|extension| extension != "json") {
            continue;
        }
        let name = path.file_stem().unwrap_or_default().display();
        let start = Instant::now();
        let tape = picture(&path);
        let recorded = start.elapsed();
        for simd in [Simd::Avx512, Simd::Avx2].into_iter().filter(|simd| simd.is_available()) {
            let start = Instant::now();
            let evaluator = Evaluator::new(&tape, simd).expect("it is available");
            let compiled = start.elapsed();
            let size = evaluator.code_bytes().expect("machine code");
            let ms = |time: Duration| time.as_secs_f64() * 1e3;
            println!("| {name}, {simd} | {:.1} | {:.1} | {} |", ms(recorded), ms(compiled), size >> 10);
            assert!(size <= 8 << 20, "{name} has {size} bytes of machine code");
        }
    }
}

/// A formula of each operation, and of each statement.
pub(super) fn operations() -> Vec<Formula> {
    formulas! {
        "add": |a, b, c| a + b;
        "add a constant": |a, b, c| a + 0.3;
        "sub": |a, b, c| a - b;
        "mul": |a, b, c| a * b;
        "div": |a, b, c| a / b;
        "fma": |a, b, c| a.mul_add(b, c);
        "fma, constant term": |a, b, c| a.mul_add(b, c.constant(0.7));
        "fma, constant factor": |a, b, c| a.mul_add(b.constant(0.7), c);
        "fma of two constants": |a, b, c| a.mul_add(b.constant(0.7), c.constant(-0.2));
        "fma of a square": |a, b, c| a.mul_add(a, a);
        "min": |a, b, c| a.min(b);
        "max": |a, b, c| a.max(b);
        "neg": |a, b, c| -a;
        "abs": |a, b, c| a.abs();
        "floor": |a, b, c| (a * 7.0).floor();
        "sqrt": |a, b, c| a.sqrt();
        "select": |a, b, c| R::select(a.lt(b), b, c);
        "and": |a, b, c| R::select(a.lt(b) & b.lt(c), b, c);
        "or": |a, b, c| R::select(a.lt(b) | b.lt(c), b, c);
        "not": |a, b, c| R::select(!a.lt(b), b, c);
        "bits": |a, b, c| {
            let mixed = ((a.to_bits() & 0x7f_ffff) + b.to_bits() * 3) ^ (c.to_bits() << 3);
            R::from_bits(((mixed >> 9) | 0x3f80_0000) & 0x3fff_ffff)
        };
        "word": |a, b, c| R::from_bits(R::word(&TABLE, index_of(a)));
        "word at a word's index": |a, b, c| {
            let word = R::word(&TABLE, R::word(&TABLE, index_of(a)) >> 17);
            R::from_bits(word) + b
        };
        "word in a branch in a loop": |a, b, c| R::repeat(5, a, |x| {
            let next = R::when(x.lt(b), x, || x * R::from_bits(R::word(&TABLE, index_of(x + c))));
            (next.lt(c), next - 0.125)
        });
        "fold": |a, b, c| {
            let (first, second) = fold(vec3(a, b, c));
            first + second * 0.5 + a.uniform(0.5)
        };
        "one value of a fold, in a branch in a loop": |a, b, c| R::repeat(4, a, |x| {
            let next = R::when(x.lt(b), x, || fold(vec3(x, b, c)).0);
            (next.lt(c), next - 0.125)
        });
        "uniform": |a, b, c| a * a.uniform(3.5) + b.uniform(0.25);
        "when": |a, b, c| R::when(a.lt(b), c, || a.sqrt() + b);
        "repeat": |a, b, c| R::repeat(9, a, |x| { let next = x * 0.7 + b; (next.abs().lt(c.abs()), next) });
        "repeat, a state copied twice": |a, b, c| {
            let (x, y, z) = R::repeat(3, (a, b, c), |(x, y, z)| (z.lt(x + 1.0), (y, x, y)));
            x + y * z
        };
        "repeat, the condition is a state and is copied": |a, b, c| {
            let (x, before, now) = R::repeat(5, (a, MaskValue(b.lt(c)), MaskValue(a.lt(b))), |(x, _, now)| {
                let next = x * 0.5 + c;
                (now.0, (next, now, MaskValue(next.lt(b))))
            });
            R::select(before.0 & !now.0, x, -x)
        };
        "repeat while many": |a, b, c| {
            let start = (a, a.constant(0.0), MaskValue(a.below(1e9)));
            let (x, turns, _) = R::repeat(99, start, |state| {
                // Lanes end at different times, and those that are left after a pause go on.
                let next = R::repeat_while_many(99, state, |(x, turns, _)| {
                    let goes_on = (turns + 1.0).lt((a * b).abs() * 40.0) & turns.below(90.0);
                    (goes_on, (x * 0.75 + c, turns + 1.0, MaskValue(goes_on)))
                });
                (next.2.0, next)
            });
            x + turns
        };
        "call": |a, b, c| {
            let (key, body) = (FunctionKey::new("step"), |(a, b): (R, R)| a * b + 1.0);
            a.call(key, (a, b), body) + c.call(key, (c, a), body)
        };
        "loop in a branch in a loop": |a, b, c| R::repeat(5, (a, c), |(x, y)| {
            let inner = R::when(x.lt(b), y, || R::repeat(4, y, |z| { let z = z.mul_add(a, b); (z.lt(c), z) }));
            (inner.abs().below(1.5), (inner * 0.6 + x * 0.3, x))
        }).0;
    }
}

#[test]
fn every_operation_gives_the_reference_bits() {
    operations().iter().for_each(compare);
}
