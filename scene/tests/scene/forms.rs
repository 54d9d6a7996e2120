//! Every form in every place: each number, point, color and shape of valid jobs is written in each other form that the language
//! has for it. A form that the schema allows there is read, with the same picture if it has the same value; any other is
//! refused where it is.

#[path = "../../../worker/tests/worker/keys/corpus.rs"]
mod corpus;
mod places;

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use scene::{ParseError, parse};
use serde_json::{Value, json};

use places::{JobValue, Kind, Schema};

/// Whether a form has the same value in all frames as what it replaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Meaning {
    /// The same picture.
    Same,
    /// The same value, but it counts as animated.
    Moving,
    /// Another value.
    Other,
}

/// A job in which one value is written in another form.
struct Form {
    job: Value,
    /// The value at the place.
    written: Value,
    meaning: Meaning,
}

/// Sum of what a test has done.
#[derive(Debug, Default)]
struct Counts {
    read: AtomicUsize,
    refused: AtomicUsize,
}

fn keys(value: &Value) -> Value {
    json!({ "keys": [[0, value], [1, value]] })
}

/// The forms of the value at a place.
fn forms(job: &Value, place: &JobValue) -> Vec<Form> {
    let with = |written: Value, meaning: Meaning| {
        let mut job = job.clone();
        *job.pointer_mut(&place.pointer).expect("the place") = written.clone();
        Form { job, written, meaning }
    };
    let named = |group: &str, name: &str, named: Value, written: Value| {
        let mut form = with(written, Meaning::Same);
        let scene = form.job["scene"].as_object_mut().expect("a scene");
        scene.entry(group).or_insert_with(|| json!({}))[name] = named;
        form
    };
    let value = &place.value;
    let expr = |formula: &str| json!({ "expr": formula });
    match place.kind {
        Kind::Number => vec![
            with(expr(&format!("{value}")), Meaning::Same),
            with(expr(&format!("({value} + 0) * 1")), Meaning::Same),
            named("numbers", "own_number", value.clone(), expr("own_number")),
            named("numbers", "own_number", json!(format!("{value}")), expr("own_number")),
            with(expr(&format!("{value} + 0 * t")), Meaning::Moving),
            with(keys(value), Meaning::Moving),
            with(
                json!({ "keys": [[0, value], [1, value, "back_out"]], "ease": [0.3, 0, 0.7, 1], "loop": "repeat" }),
                Meaning::Moving,
            ),
            named("numbers", "own_track", keys(value), expr("own_track")).moving(),
        ],
        Kind::Point => {
            let numbers = value.as_array().expect("a list").iter();
            let numbers =
                numbers.map(|number| if number.is_number() { expr(&format!("{number} + 0")) } else { number.clone() });
            vec![
                with(numbers.collect(), Meaning::Same),
                with(keys(value), Meaning::Moving),
                with(json!({ "keys": [[0, value], [1, value, "smooth"]], "loop": "ping_pong" }), Meaning::Moving),
            ]
        }
        Kind::Color => {
            let black = ["#000000", "#000", "rgb(0, 0, 0)", "rgb(0% 0% 0%)"].map(|text| json!(text));
            let lists = [json!([0, 0, 0]), json!([expr("1 - 1"), 0, expr("0")])];
            let tracks = [
                keys(value),
                keys(&json!("#203040")),
                keys(&json!({ "kelvin": 4000 })),
                json!({ "kelvin": keys(&json!(4000)) }),
            ];
            let kelvin = [json!({ "kelvin": 4000 }), json!({ "kelvin": expr("2 * 2000") })];
            let other = black.into_iter().chain(lists).chain(tracks).chain(kelvin);
            other.map(|written| with(written, Meaning::Other)).collect()
        }
        Kind::Node => {
            let uses = |with: Value| json!({ "use": { "shape": "own_shape", "with": with } });
            let mut forms = vec![named("shapes", "own_shape", value.clone(), json!({ "use": "own_shape" }))];
            forms.push(named("shapes", "own_shape", value.clone(), uses(json!({}))));
            if let Some((pointer, number)) = places::first_number(value) {
                let mut shape = value.clone();
                *shape.pointer_mut(&pointer).expect("the number") = expr("own_number");
                forms.push(named("shapes", "own_shape", shape.clone(), uses(json!({ "own_number": number }))));
                forms.push(named("shapes", "own_shape", shape, uses(json!({ "own_number": format!("{number} + 0") }))));
            }
            // A shape does not use itself.
            forms.retain(|_| !place.pointer.starts_with("/scene/shapes/"));
            forms
        }
    }
}

impl Form {
    fn moving(self) -> Self {
        Self { meaning: Meaning::Moving, ..self }
    }

    /// The error in how the form is read.
    fn check(&self, schema: &Schema, place: &JobValue, key: &str, counts: &Counts) -> Option<String> {
        let is_allowed = schema.allows(&place.schema, &self.written);
        let errors = match parse(self.job.to_string().as_bytes()) {
            Ok(job) => {
                counts.read.fetch_add(1, Ordering::Relaxed);
                return match self.meaning {
                    _ if !is_allowed => Some("is read, but the schema does not allow it".to_owned()),
                    Meaning::Same if job.cache_key(0).to_hex().as_str() != key => Some("is another picture".to_owned()),
                    Meaning::Moving if !job.is_animated() && !place.is_named() => Some("is not animated".to_owned()),
                    Meaning::Same | Meaning::Moving | Meaning::Other => None,
                };
            }
            Err(ParseError::NotJson(error)) => vec![error],
            Err(ParseError::Invalid(errors)) => errors,
        };
        counts.refused.fetch_add(1, Ordering::Relaxed);
        let reported: Vec<String> = errors.iter().map(ToString::to_string).collect();
        let reported = reported.join("; ");
        let is_here = errors.iter().all(|error| {
            error.pointer.starts_with(&place.pointer)
                || place.pointer.starts_with(&error.pointer)
                || error.pointer.starts_with("/scene/shapes")
        });
        let is_clear = ["must be", "write", "use ", "cannot be a track"].iter().any(|cure| reported.contains(cure));
        // The schema cannot say what holds between several values, such as that placements do not move.
        let is_rule = self.meaning == Meaning::Moving
            && ["animated", "the same in all frames", "the same for all frames"]
                .iter()
                .any(|words| reported.contains(words));
        (!(is_here && is_clear && (!is_allowed || is_rule))).then(|| format!("is refused: {reported}"))
    }
}

/// Checks all forms of the values of some jobs at places that `is_chosen`.
fn check(jobs: &[Value], is_chosen: impl Fn(&JobValue) -> bool + Sync) -> Counts {
    let (schema, counts, next) = (Schema::new(scene::schema()), Counts::default(), AtomicUsize::new(0));
    let wrong = std::sync::Mutex::new(Vec::new());
    let check_jobs = || {
        while let Some(job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
            let key = parse(job.to_string().as_bytes()).unwrap_or_else(|error| panic!("{job}: {error}")).cache_key(0);
            for place in schema.places(job).into_iter().filter(|place| is_chosen(place)) {
                for form in forms(job, &place) {
                    if let Some(fault) = form.check(&schema, &place, key.to_hex().as_str(), &counts) {
                        let Form { written, .. } = &form;
                        wrong
                            .lock()
                            .unwrap()
                            .push(format!("{} from {} to {written} {fault}", place.pointer, place.value));
                    }
                }
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(check_jobs);
        }
    });
    let wrong = wrong.into_inner().unwrap();
    assert!(wrong.is_empty(), "{} wrong forms:\n{}", wrong.len(), wrong.join("\n"));
    counts
}

#[test]
fn each_place_of_the_schema_takes_every_form_that_it_allows() {
    let seen = std::sync::Mutex::new(BTreeSet::new());
    // A place of the schema is tested once, in the first job that has it.
    let counts = check(&corpus::jobs(), |place| seen.lock().unwrap().insert((place.property.clone(), place.kind)));
    let places = seen.into_inner().unwrap().len();
    assert!(places >= 250 && counts.read.into_inner() >= 1000, "{places} places");
}

#[test]
#[ignore = "long: every value of all small jobs, not only the first of each place; 25 s"]
fn each_value_of_all_jobs_takes_every_form_that_its_place_allows() {
    let mut jobs = corpus::jobs();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    for entry in std::fs::read_dir(folder).expect("the shipped scenes") {
        let path = entry.expect("an entry").path();
        let text = path.extension().is_some_and(|kind| kind == "json").then(|| std::fs::read_to_string(&path).unwrap());
        // A large scene has the places of the smaller ones, many times.
        if let Some(text) = text.filter(|text| text.len() < 10_000) {
            jobs.push(serde_json::from_str(&scene::plain_json(&text)).unwrap());
        }
    }
    let counts = check(&jobs, |_| true);
    assert!(counts.read.into_inner() >= 10_000);
}
