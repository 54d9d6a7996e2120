//! Evaluations of the scene's distance are counted exactly: a number that counts the calls of the distance as the
//! reference makes them is the witness.

use std::cell::Cell;
use std::ops::{Add, Div, Mul, Neg, Sub};

use proto::Rect;
use rayon::prelude::*;
use scene::real::{Bundle, FunctionKey, Real, Table};
use scene::{ImageSpec, Integrator, Job};
use worker::{CpuRenderer, Simd, TileRequest};

use crate::lanes::levels;
use crate::shipped::shipped;

/// Names of the functions that evaluate the distance of the scene as each kind of ray sees it.
const DISTANCES: [&str; 6] = [
    "distance",
    "distance_of_shadows",
    "distance_of_reflections",
    "nearest",
    "nearest_of_shadows",
    "nearest_of_reflections",
];

thread_local! {
    static CALLS: Cell<u64> = const { Cell::new(0) };
}

/// An `f32` that counts calls of the scene's distance.
#[derive(Clone, Copy, Debug)]
struct Counting(f32);

macro_rules! operators {
    ($($Op:ident $op:ident),*) => { $(
        impl $Op for Counting {
            type Output = Self;
            fn $op(self, other: Self) -> Self {
                Self(self.0.$op(other.0))
            }
        }
        impl $Op<f32> for Counting {
            type Output = Self;
            fn $op(self, other: f32) -> Self {
                Self(self.0.$op(other))
            }
        }
    )* };
}

operators![Add add, Sub sub, Mul mul, Div div];

impl Neg for Counting {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl Real for Counting {
    type Mask = bool;
    type Bits = <f32 as Real>::Bits;

    fn constant(self, value: f32) -> Self {
        Self(value)
    }

    fn word(table: &Table, index: Self::Bits) -> Self::Bits {
        f32::word(table, index)
    }

    fn made(table: &Table, missing: Self::Bits) -> Self::Bits {
        f32::made(table, missing)
    }

    fn mul_add(self, factor: Self, term: Self) -> Self {
        Self(Real::mul_add(self.0, factor.0, term.0))
    }

    fn sqrt(self) -> Self {
        Self(Real::sqrt(self.0))
    }

    fn abs(self) -> Self {
        Self(self.0.abs())
    }

    fn floor(self) -> Self {
        Self(self.0.floor())
    }

    fn min(self, other: Self) -> Self {
        Self(Real::min(self.0, other.0))
    }

    fn max(self, other: Self) -> Self {
        Self(Real::max(self.0, other.0))
    }

    fn lt(self, other: Self) -> bool {
        self.0 < other.0
    }

    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }

    fn to_bits(self) -> Self::Bits {
        Real::to_bits(self.0)
    }

    fn from_bits(bits: Self::Bits) -> Self {
        Self(Real::from_bits(bits))
    }

    fn when<T: Bundle<Self>>(mask: bool, otherwise: T, then: impl FnOnce() -> T) -> T {
        if mask { then() } else { otherwise }
    }

    fn repeat<T: Bundle<Self>>(limit: u32, state: T, mut step: impl FnMut(T) -> (bool, T)) -> T {
        let mut state = state;
        for _ in 0..limit {
            let (again, next) = step(state);
            state = next;
            if !again {
                break;
            }
        }
        state
    }

    fn call<A: Bundle<Self>, T: Bundle<Self>>(self, key: FunctionKey, arguments: A, body: impl FnOnce(A) -> T) -> T {
        if DISTANCES.contains(&key.name()) {
            CALLS.set(CALLS.get() + 1);
        }
        body(arguments)
    }
}

/// Calls of the scene's distance for all pixels of a job.
fn calls(job: &Job) -> u64 {
    let at_frame = job.at(0).expect("the job is valid");
    let (program, &ImageSpec { width, height, .. }) = (Integrator::new(&at_frame), &job.image);
    CALLS.set(0);
    for y in 0..height {
        for x in 0..width {
            program.pixel(Counting(x as f32), Counting(y as f32));
        }
    }
    CALLS.get()
}

/// Their number as every way to evaluate counts it, which is one.
fn counted(job: &Job) -> u64 {
    let rect = Rect::full(job.image.width, job.image.height);
    let count = |simd: Simd| {
        let renderer = CpuRenderer::new(Some(1), simd).expect("this machine has a CPU");
        renderer.evaluations(&TileRequest { job, frame: 0, rect }).expect("the job is valid")
    };
    let counts: Vec<u64> = levels().map(count).collect();
    assert!(counts.windows(2).all(|pair| pair[0] == pair[1]), "{counts:?}");
    counts[0]
}

#[test]
fn counts_are_the_calls_of_every_shipped_scene() {
    let compare = |(name, job): (String, Job)| {
        let (calls, counted) = (calls(&job), counted(&job));
        (calls != counted).then(|| format!("{name}: {counted} are counted, {calls} were made"))
    };
    let jobs: Vec<(String, Job)> =
        shipped().into_iter().map(|shipped| (shipped.name.clone(), shipped.png(21, 2))).collect();
    let wrong: Vec<String> = jobs.into_par_iter().filter_map(compare).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A fractal, glass, a cloud and a mirror, in fog and in ambient occlusion.
const EVERYTHING: &str = r#"{
  "scene": {
    "camera": { "position": [1.5, 0.9, 3.2], "look_at": [0, 0, 0] },
    "lights": [{ "point": { "position": [-2, 3, 2], "color": [9, 8, 7] } },
               { "directional": { "direction": [0.6, 0.7, 0.5] } },
               { "sky": { "from": { "color": [0.3, 0.4, 0.5] } } }],
    "fog": { "density": 0.05, "color": [0.2, 0.2, 0.3] },
    "ambient_occlusion": { "distance": 0.3 },
    "materials": {
      "stone": { "diffuse": { "kd": [0.5, 0.4, 0.3] } },
      "glass": { "surface": { "transmission": 1, "ior": 1.5, "roughness": 0 } },
      "mirror": { "surface": { "metallic": 1, "roughness": 0.1 } },
      "cloud": { "volume": { "density": 3, "steps": 24, "light_steps": 4 } }
    },
    "objects": [
      { "material": "stone", "shape": { "mandelbulb": { "power": 8, "iterations": 6 } } },
      { "material": "glass", "shape": { "translate": { "by": [1.2, 0, 1], "child": { "sphere": { "radius": 0.5 } } } } },
      { "material": "cloud", "shape": { "translate": { "by": [-1, 0.5, 1], "child": { "sphere": { "radius": 0.7 } } } } },
      { "material": "mirror", "shape": { "plane": { "normal": [0, 1, 0], "offset": -1.2 } } }
    ]
  },
  "image": { "width": 24, "height": 16, "samples": 2 }
}"#;

#[test]
fn counts_are_the_calls_where_everything_meets() {
    let job = scene::parse(EVERYTHING.as_bytes()).expect("a valid job");
    assert_eq!(counted(&job), calls(&job));
}

/// Counts are sums of `f32` numbers, which are exact up to 2²⁴.
#[test]
fn counts_of_many_samples_are_exact() {
    let few = scene::parse(EVERYTHING.as_bytes()).expect("a valid job");
    let image = ImageSpec { width: 2, height: 1, samples: 130.into(), ..few.image.clone() };
    let job = few.with_image(image);
    assert_eq!(counted(&job), calls(&job));
}
