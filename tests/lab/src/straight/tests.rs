//! The yardstick of distances: straight C++ that does the same work as the evaluators.

use std::time::Duration;

use worker::Simd;

use super::StraightError;
use super::measure::{Row, measure};
use crate::program::job_text;
use crate::skip::skip;

/// Levels of vector instructions; prints a `skipped:` line for each that this CPU lacks.
fn levels() -> impl Iterator<Item = Simd> {
    [Simd::Avx512, Simd::Avx2].into_iter().filter(|level| {
        let available = level.is_available();
        if !available {
            skip(level.name(), format_args!("this CPU has no {level}"));
        }
        available
    })
}

fn measured(name: &str, simd: Simd) -> Row {
    let job = scene::parse(&job_text(name).expect("it is shipped")).expect("it is valid");
    measure(&job, simd, Duration::from_millis(10)).expect("the job is valid")
}

#[test]
fn straight_code_gives_the_evaluators_bits() {
    for simd in levels() {
        for name in ["csg", "five-spheres"] {
            let row = measured(name, simd);
            match row.straight_error {
                None => {}
                Some(StraightError::NoCompiler) => return skip("c++", "no distance was compared with straight C++"),
                // Distances that differ in a bit are an error, too.
                Some(error) => panic!("{name} with {simd}: {error}"),
            }
            let straight = row.straight.expect("it was measured");
            assert!(straight.points_per_second > 0.0 && straight.ratio.least <= straight.ratio.greatest);
        }
    }
}

#[test]
fn only_straight_distances_have_a_yardstick() {
    let row = measured("csg", Simd::Portable);
    assert!(matches!(row.straight_error, Some(StraightError::NoVectors("portable"))), "{row:?}");
    for simd in levels() {
        let row = measured("mandelbulb", simd);
        assert!(matches!(row.straight_error, Some(StraightError::Loops)), "{row:?}");
        assert!(row.straight.is_none() && row.points_per_second.median > 0.0);
    }
}
