//! The yardstick of distances: straight C++ that does the same work as the evaluators.

use std::time::Duration;

use worker::Simd;
use worker::bench::{PointsReport, StraightError, Yardstick, points};

use crate::lanes::levels;
use crate::shipped::shipped;
use crate::skip::skip;

fn measured(name: &str, simd: Simd) -> PointsReport {
    let shipped = shipped().into_iter().find(|shipped| shipped.name == name).expect("it is shipped");
    points(&shipped.job(), simd, Duration::from_millis(10), Yardstick::Straight).expect("the job is valid")
}

#[test]
fn straight_code_gives_the_evaluators_bits() {
    for simd in levels().filter(|simd| matches!(simd, Simd::Avx512 | Simd::Avx2)) {
        for name in ["csg", "five-spheres"] {
            let report = measured(name, simd);
            match report.straight_error {
                None => {}
                Some(StraightError::NoCompiler) => return skip("c++", "no distance was compared with straight C++"),
                // Distances that differ in a bit are an error, too.
                Some(error) => panic!("{name} with {simd}: {error}"),
            }
            let straight = report.straight.expect("it was measured");
            assert!(straight.points_per_second > 0.0 && straight.ratio.least <= straight.ratio.greatest);
        }
    }
}

#[test]
fn only_straight_distances_have_a_yardstick() {
    let report = measured("csg", Simd::Portable);
    assert!(matches!(report.straight_error, Some(StraightError::NoVectors("portable"))), "{report:?}");
    for simd in levels().filter(|simd| matches!(simd, Simd::Avx512 | Simd::Avx2)) {
        let report = measured("mandelbulb", simd);
        assert!(matches!(report.straight_error, Some(StraightError::Loops)), "{report:?}");
        assert!(report.straight.is_none() && report.points_per_second > 0.0);
    }
}
