//! The list of a cell gives the value of the whole scene, bit for bit, and its bound is never more than a distance in it.

use std::fs;

use scene::bounds::Bounds;
use scene::cells::{Cells, ScalarBuilder};
use scene::real::{Vec3, vec3};
use scene::{Job, parse};

struct Random(u32);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((self.0 >> ((self.0 >> 28) + 4)) ^ self.0).wrapping_mul(277_803_737);
        (((word >> 22) ^ word) >> 8) as f32 / (1 << 24) as f32
    }

    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.next()
    }

    fn point(&mut self, reach: f32) -> Vec3<f32> {
        vec3(self.between(-reach, reach), self.between(-reach, reach), self.between(-reach, reach))
    }
}

/// Box with corners at ±`reach`.
fn around(reach: f32) -> Bounds {
    Bounds::symmetric(reach, reach, reach)
}

/// Compares cells with the whole program at random points, and on the faces of cells.
fn check(name: &str, job: &Job, points: u32) {
    let still = job.at(0).expect("the first frame");
    let objects: Vec<_> =
        still.scene().objects.iter().enumerate().map(|(index, object)| (index, object, None)).collect();
    let Some(cells) = Cells::new(&objects, around(40.0), &ScalarBuilder) else { return };
    let mut random = Random(3);
    let (mut empty, mut near) = (0, 0);
    for index in 0..points {
        let reach = [3.0, 10.0, 39.0, 50.0][index as usize % 4];
        let p = random.point(reach);
        for p in [p, cells.on_face(p, 0), cells.on_face(p, 1), cells.on_face(p, -1)] {
            let cell = cells.locate(p);
            let (whole, listed) = (cells.program().distance(p), cells.fold(&cell, p));
            assert_eq!(whole.to_bits(), listed.to_bits(), "{name} at {p:?}: {whole}, and {listed} by cells");
            assert!(cell.bound <= whole.max(0.0), "{name} at {p:?}: {whole}, bound {}", cell.bound);
            if cell.bound > 0.0 { empty += 1 } else { near += 1 }
        }
    }
    println!(
        "{name}: {} leaves, {} families, {} words, {empty} empty, {near} near",
        cells.program().leaf_count(),
        cells.program().family_count(),
        cells.tree().words().len()
    );
}

#[test]
fn cells_of_every_shipped_scene_give_the_value_of_the_whole() {
    for entry in fs::read_dir("../scenes").expect("the shipped scenes") {
        let path = entry.expect("an entry").path();
        if path.extension().is_some_and(|extension| extension == "json") {
            let job = parse(&fs::read(&path).expect("a file")).expect("a valid job");
            check(&path.display().to_string(), &job, 400);
        }
    }
}
