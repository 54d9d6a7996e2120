//! Paths of light for `paths.cu`, which runs their loops: the steps of [`PathSteps`](scene::integrator::PathSteps), recorded
//! as functions of numbers, and C functions that call them with lists of numbers.

use std::fmt::Write;

use scene::Integrator;
use scene::integrator::Lane;
use scene::real::{Bundle, Merge, Real};

use tape::{BoolExpr, Expr, PAUSE, Recording};

/// C source of lists of numbers, and of the functions that fill them.
#[derive(Debug)]
pub(crate) struct PathSource {
    /// Number of words of each list.
    pub(crate) sizes: String,
    pub(crate) functions: String,
}

/// Records the steps of an integrator's paths; returns the source that calls them. `None` if it does not take them.
pub(crate) fn record_steps(
    recording: &Recording,
    integrator: &Integrator<'_>,
    sum_channels: usize,
) -> Option<PathSource> {
    let paths = integrator.path_steps()?;
    let mut lanes = None;
    recording.entry_of("lane_start", 3 + sum_channels, |all| {
        let lane = paths.start(all[0], all[1], all[2], integrator.sum_of_channels(&all[3..]));
        let (lane, without) = *lanes.insert((lane, uncounted(&lane)));
        numbers_of(lane, without)
    });
    let (lane, without) = lanes.expect("it was recorded");
    let (march, words) = (lane.march(), count(lane, without));
    let mut rays = None;
    recording.entry_of("ray_of_lane", words, |all| {
        let ray = paths.marched_ray(&from_numbers(lane, without, all));
        numbers_of(*rays.insert(ray), ray)
    });
    let ray = rays.expect("it was recorded");
    let (march_words, ray_words) = (count(march, march), count(ray, ray));
    recording.entry_of("march_step", ray_words + march_words, |mut all| {
        let march = from_numbers(march, march, all.split_off(ray_words));
        let next = paths.march_step(&from_numbers(ray, ray, all), march);
        numbers_of(next, next)
    });
    recording.entry_of("after_march", 2 + words, |mut all| {
        let before = from_numbers(lane, without, all.split_off(2));
        let after = paths.after_march(all[0], all[1], before);
        numbers_of(after, uncounted(&after))
    });
    let sizes = format!(
        "#define LANE_WORDS {words}u\n#define MARCH_WORDS {march_words}u\n#define RAY_WORDS {ray_words}u\n\
        #define PAUSE {PAUSE}u\n"
    );
    let list =
        |name: &str, count: usize| (0..count).map(|word| format!("{name}[{word}]")).collect::<Vec<_>>().join(", ");
    let (lane, march, ray) = (list("lane", words), list("march", march_words), list("ray", ray_words));
    let mut functions = String::new();
    let mut function = |name: &str, parameters: &str, given: String, into: &str, count: usize| {
        let _ = write!(
            functions,
            "INLINE_FN void {name}_into({parameters}) {{\n    const {name}_result step = step_{name}({given});\n"
        );
        for word in 0..count {
            let _ = writeln!(functions, "    {into}[{word}] = step.f{word};");
        }
        functions.push_str("}\n\n");
    };
    function(
        "lane_start",
        "float x, float y, float sample, const Sum& sum, float* lane",
        "x, y, sample, sum.red, sum.green, sum.blue, sum.alpha PARTS_OF(sum)".to_owned(),
        "lane",
        words,
    );
    function("ray_of_lane", "const float* lane, float* ray", lane.clone(), "ray", ray_words);
    function("march_step", "const float* ray, float* march", format!("{ray}, {march}"), "march", march_words);
    function("after_march", "float x, float y, float* lane", format!("x, y, {lane}"), "lane", words);
    Some(PathSource { sizes, functions })
}

/// The lane with other numbers in place of its evaluations, which are not counted.
fn uncounted(lane: &Lane<Expr>) -> Lane<Expr> {
    lane.without_evaluations(Expr::literal(-1.0))
}

/// Numbers of a bundle, conditions as 1 and 0, but for those that are others in `without`.
fn numbers_of<T: Bundle<Expr>>(bundle: T, without: T) -> Vec<Expr> {
    let mut numbers = Numbers(Vec::new());
    bundle.merge(without, &mut numbers);
    numbers.0
}

/// The bundle with these numbers, like `example`.
fn from_numbers<T: Bundle<Expr>>(example: T, without: T, numbers: Vec<Expr>) -> T {
    example.merge(without, &mut FromNumbers(numbers.into_iter()))
}

/// Length of the list [`numbers_of`] a bundle.
fn count<T: Bundle<Expr>>(bundle: T, without: T) -> usize {
    let mut count = Count(0);
    bundle.merge(without, &mut count);
    count.0
}

struct Numbers(Vec<Expr>);

impl Merge<Expr> for Numbers {
    fn number(&mut self, number: Expr, without: Expr) -> Expr {
        self.0.extend(number.is(without).then_some(number));
        number
    }

    fn mask(&mut self, condition: BoolExpr, _: BoolExpr) -> BoolExpr {
        self.0.push(Expr::select(condition, Expr::literal(1.0), Expr::literal(0.0)));
        condition
    }
}

struct FromNumbers(std::vec::IntoIter<Expr>);

impl FromNumbers {
    fn next(&mut self) -> Expr {
        self.0.next().expect("there are as many numbers as were counted")
    }
}

impl Merge<Expr> for FromNumbers {
    fn number(&mut self, example: Expr, without: Expr) -> Expr {
        if example.is(without) { self.next() } else { Expr::literal(0.0) }
    }

    fn mask(&mut self, _: BoolExpr, _: BoolExpr) -> BoolExpr {
        self.next().above(0.5)
    }
}

struct Count(usize);

impl Merge<Expr> for Count {
    fn number(&mut self, number: Expr, without: Expr) -> Expr {
        self.0 += usize::from(number.is(without));
        number
    }

    fn mask(&mut self, condition: BoolExpr, _: BoolExpr) -> BoolExpr {
        self.0 += 1;
        condition
    }
}
