//! Formulas, named numbers and shapes with numbers: a job with them is the job with their values.

use scene::{Job, ParseError, ValidationError, parse};

/// A job with this scene members and objects.
fn text(numbers: &str, shapes: &str, shape: &str, more: &str) -> String {
    format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 9], "look_at": [0, 0, 0] }},
            "numbers": {{ {numbers} }}, "shapes": {{ {shapes} }},
            "objects": [{{ "shape": {shape} }}] }}, "image": {{ "width": 8, "height": 8 }}{more} }}"#
    )
}

fn job(text: &str) -> Job {
    parse(text.as_bytes()).unwrap_or_else(|error| panic!("{text}\n{error}"))
}

fn errors(text: &str) -> Vec<ValidationError> {
    match parse(text.as_bytes()) {
        Err(ParseError::Invalid(errors)) => errors,
        Err(other) => panic!("{text}\n{other}"),
        Ok(_) => panic!("{text}\nis valid"),
    }
}

/// The radius of the job's sphere in a frame.
fn radius(job: &Job, frame: u32) -> f32 {
    let at = job.at(frame).unwrap_or_else(|error| panic!("{error}"));
    at.scene().objects[0].shape.bounds(0.0).max.x
}

fn sphere(radius: &str) -> String {
    format!(r#"{{ "sphere": {{ "radius": {radius} }} }}"#)
}

fn of_formula(formula: &str) -> f32 {
    radius(&job(&text(r#""r": 0.5, "two": "r * 4""#, "", &sphere(&format!(r#"{{ "expr": "{formula}" }}"#)), "")), 0)
}

#[test]
fn formulas_follow_the_usual_precedence() {
    for (formula, value) in [
        ("1 + 2 * 3", 7.0),
        ("(1 + 2) * 3", 9.0),
        ("2 ^ 3 ^ 2 / 512", 1.0),
        ("-2 ^ 2 + 5", 1.0),
        ("2 * -3 + 7", 1.0),
        ("10 - 4 - 3", 3.0),
        ("7 % 4", 3.0),
        ("1 + (2 < 3)", 2.0),
        ("1 + (2 == 3)", 1.0),
        (" 1e1 + .5 ", 10.5),
        ("two / r", 4.0),
        ("max(1, two, 3)", 3.0),
        ("min(1, two, 3)", 1.0),
        ("sin(90) + cos(60)", 1.5),
        ("atan2(1, 1)", 45.0),
        ("sqrt(16)", 4.0),
        ("clamp(9, 1, 4)", 4.0),
        ("mix(1, 3, 0.25)", 1.5),
        ("smoothstep(0, 2, 1) + 1", 1.5),
        ("if(two > 3, 2, 3)", 3.0),
        ("hypot(3, 4)", 5.0),
        ("(-2) ^ 2", 4.0),
        ("frames + 1", 2.0),
    ] {
        let got = of_formula(formula);
        assert!((got - value).abs() <= 1e-6 * value, "{formula} is {got}, not {value}");
    }
}

#[test]
fn a_formula_of_constants_is_a_plain_number() {
    let formula = job(&text(r#""r": "two / 4", "two": 2"#, "", &sphere(r#"{ "expr": "r * 3" }"#), ""));
    let plain = job(&text("", "", &sphere("1.5"), ""));
    assert!(!formula.is_animated());
    assert_eq!(formula.cache_key(0), plain.cache_key(0));
}

#[test]
fn a_formula_of_time_has_a_value_in_each_frame() {
    let frames = r#", "frames": { "count": 5, "fps": 2 }"#;
    let moving = job(&text(r#""r": 2, "wave": "r + t""#, "", &sphere(r#"{ "expr": "wave + frame" }"#), frames));
    assert!(moving.is_animated());
    assert_eq!([0, 1, 2, 4].map(|frame| radius(&moving, frame)), [2.0, 3.5, 5.0, 8.0]);
    // A named track in a formula.
    let numbers = r#""grow": { "keys": [[0, 1], [1, 3]] }"#;
    let track = job(&text(numbers, "", &sphere(r#"{ "expr": "2 * grow" }"#), frames));
    assert_eq!([0, 1, 2, 4].map(|frame| radius(&track, frame)), [2.0, 4.0, 6.0, 6.0]);
}

#[test]
fn a_branch_that_is_not_taken_needs_no_finite_value() {
    assert_eq!(of_formula("if(two == 2, 3, 1 / 0)"), 3.0);
    assert_eq!(of_formula("if(0, 1 + sqrt(0 - 1) * 2, 3)"), 3.0);
    assert_eq!(of_formula("2 * if(1, if(0, ln(0), 1.5), 1 / 0)"), 3.0);
    let shape = r#"{ "copies": { "child": { "sphere": { "radius": 1 } },
        "at": { "count": 3, "by": [{ "expr": "if(i == 0, 0, 1 / i)" }, 0, 0] } } }"#;
    job(&text("", "", shape, ""));
    // Which one is taken may depend on time.
    let over_time = |formula: &str| sphere(&format!(r#"{{ "expr": "{formula}" }}"#));
    let frames = r#", "frames": { "count": 3, "fps": 1 }"#;
    let moving_job = |formula: &str| parse(text("", "", &over_time(formula), frames).as_bytes());
    let moving = moving_job("if(t == 9, 1 / 0, 1 + t)").expect("it is never taken");
    assert_eq!([0, 1, 2].map(|frame| radius(&moving, frame)), [1.0, 2.0, 3.0]);
    assert!(moving_job("if(t == 1, 1 / 0, 1 + t)").is_err(), "it is taken once");
    for (formula, words) in [
        ("if(1, 1 / 0, 2)", "1 / 0 has no finite value"),
        ("if(1 / 0, 1, 2)", "1 / 0 has no finite value"),
        ("if(0, radius, 2)", "radius is not defined"),
        ("if(0, sin(1, 2), 2)", "sin has 2 arguments"),
    ] {
        let all = errors(&text("", "", &over_time(formula), ""));
        assert!(all.len() == 1 && all[0].message.contains(words), "{formula}: {all:?}");
    }
}

#[test]
fn any_number_may_be_a_formula() {
    let of = |edge: &str, count: &str, seed: &str, samples: &str| {
        format!(
            r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 9], "look_at": [0, 0, 0] }}, "numbers": {{ "size": 4 }},
                "objects": [{{ "shape": {{ "repeat": {{ "cell": [2, null, null], "count": [{count}, null, null],
                    "child": {{ "box": {{ "size": [1, {edge}, 1] }} }} }} }} }}] }},
                "image": {{ "width": {{ "expr": "2 * size" }}, "height": 8, "seed": {seed}, "samples": {samples} }} }}"#
        )
    };
    let formulas =
        of(r#"{ "expr": "size / 8" }"#, r#"{ "expr": "size - 1" }"#, r#"{"expr":"size"}"#, r#"{"expr":"2^2"}"#);
    let (formulas, plain) = (job(&formulas), job(&of("0.5", "3", "4", "4")));
    assert_eq!(formulas.image.width, 8);
    assert_eq!(formulas.cache_key(0), plain.cache_key(0));
}

#[test]
fn a_shape_has_numbers_of_its_own() {
    let shapes = r#""ball": { "sphere": { "radius": { "expr": "r" } } },
        "pair": { "union": { "of": [
            { "use": { "shape": "ball", "with": { "r": "r / 2" } } },
            { "translate": { "by": [{ "expr": "2 * r" }, 0, 0], "child": { "use": "ball" } } }
        ] } }"#;
    let with = |r: &str| format!(r#"{{ "use": {{ "shape": "pair", "with": {{ "r": {r} }} }} }}"#);
    let written = |half: f32, by: f32, whole: f32| {
        format!(
            r#"{{ "union": {{ "of": [{}, {{ "translate": {{ "by": [{by}, 0, 0], "child": {} }} }}] }} }}"#,
            sphere(&half.to_string()),
            sphere(&whole.to_string())
        )
    };
    for (r, half, by) in [("2", 1.0, 4.0), (r#""1 + 2""#, 1.5, 6.0), (r#"{ "expr": "r * 4" }"#, 1.0, 4.0)] {
        // The inner ball alone has the numbers of the scene.
        let job = job(&text(r#""r": 0.5"#, shapes, &with(r), ""));
        let plain = self::job(&text("", "", &written(half, by, 0.5), ""));
        assert_eq!(job.cache_key(0), plain.cache_key(0), "{r}");
    }
    // Without a number of the scene, every use must give one.
    let shapes = r#""ball": { "sphere": { "radius": { "expr": "r" } } }"#;
    let ball = r#"{ "use": { "shape": "ball", "with": { "r": 2 } } }"#;
    assert_eq!(radius(&job(&text("", shapes, ball, "")), 0), 2.0);
    let [error] = &errors(&text("", shapes, r#"{ "use": "ball" }"#, ""))[..] else { panic!("one error is expected") };
    assert_eq!(error.pointer, "/scene/shapes/ball/sphere/radius/expr");
    assert!(error.message.contains("r is not defined"), "{error}");
}

#[test]
fn counted_placements_are_a_list() {
    let copies = |at: &str| format!(r#"{{ "copies": {{ "child": {}, "at": {at} }} }}"#, sphere("0.25"));
    let counted = copies(
        r#"{ "count": { "expr": "k" }, "by": [{ "expr": "i * 2" }, { "expr": "n" }, 0], "scale": { "expr": "1 + i" } }"#,
    );
    let listed = copies(
        r#"[{ "by": [0, 3, 0], "scale": 1 }, { "by": [2, 3, 0], "scale": 2 }, { "by": [4, 3, 0], "scale": 3 }]"#,
    );
    let (counted, listed) = (job(&text(r#""k": 3"#, "", &counted, "")), job(&text("", "", &listed, "")));
    assert_eq!(counted.cache_key(0), listed.cache_key(0));
}

#[test]
fn comments_and_trailing_commas_are_ignored() {
    let commented = r#"{
        "$schema": "https://example.com/job.json", // for editors
        "scene": { "camera": { "position": [0, 0, 9], "look_at": [0, 0, 0,] /* the origin */ },
            "objects": [{ "shape": { "sphere": { "radius": 1 } } },], },
        "image": { "width": 8, "height": 8 }, }"#;
    assert_eq!(job(commented).cache_key(0), job(&text("", "", &sphere("1"), "")).cache_key(0));
    // Errors have their positions in the text with comments.
    let wrong = commented.replace("\"radius\": 1", "/* large */ \"radius\": -1");
    let error = &errors(&wrong)[0];
    assert_eq!((error.line, error.pointer.as_str()), (4, "/scene/objects/0/shape/sphere/radius"));
    assert_eq!(wrong.lines().nth(3).unwrap()[error.column as usize - 1..].split(' ').next(), Some("-1"));
}

/// The text at an error, up to a space.
fn found<'t>(text: &'t str, error: &ValidationError) -> &'t str {
    let line = text.lines().nth(error.line as usize - 1).unwrap();
    line[error.column as usize - 1..].split(' ').next().unwrap()
}

#[test]
fn an_error_points_into_the_formula() {
    for (formula, at, words) in [
        ("1 + radius", "radius\"", "radius is not defined: add it to the scene's numbers; did you mean radios?"),
        ("1 +", "\"", "ends too early: write a number, a name or a parenthesis"),
        ("(1 + 2", "(1", "not closed"),
        ("1 + 2)", ")\"", "remove it"),
        ("1 2", "2\"", "an operator is missing before this"),
        ("2 radios", "radios\"", "write * to multiply"),
        ("1 / 0", "1", "1 / 0 has no finite value"),
        ("1 + sqrt(0 - 1)", "sqrt(0", "sqrt(-1) has no finite value"),
        ("sine(1)", "sine(1)\"", "sine is no function: did you mean sin?"),
        ("sin(1, 2)", "sin(1,", "sin has 2 arguments: write sin(degrees)"),
        ("sin + 1", "sin", "sin is a function"),
        ("i + 1", "i", "counts copies"),
        ("a = 1", "=", "use == to compare"),
        ("1 & 2", "&", "is no operator"),
        ("1e99", "1e99\"", "too large"),
        ("1,5", ",5\"", "use . in numbers"),
        ("", "\"", "is empty: write a formula"),
        ("-1", "{", "must be a size from 1e-6 to 1e6, not -1"),
        ("t - 1", "{", "must be a size from 1e-6 to 1e6, not -1"),
    ] {
        let text = text(r#""radios": 1, "a": 1"#, "", &sphere(&format!(r#"{{ "expr": "{formula}" }}"#)), "");
        let all = errors(&text);
        let [error] = &all[..] else { panic!("{formula}: {all:?}") };
        assert!(error.message.contains(words), "{formula}: {error}");
        assert_eq!(found(&text, error), at, "{formula}: {error}");
        assert!(error.pointer.starts_with("/scene/objects/0/shape/sphere/radius"), "{formula}: {error}");
    }
}

#[test]
fn all_errors_of_formulas_and_of_the_rest_are_reported_at_once() {
    let numbers = r#""a": "b + 1", "b": "a + 1", "c": "1 +", "t": 1, "sin": 2, "x y": 3, "deep": { "keys": [] }"#;
    let shape = r#"{ "union": { "of": [
        { "sphere": { "radius": { "expr": "none" } } }, { "sphere": { "radius": -1 } }, { "cube": {} }
    ] } }"#;
    let text = text(numbers, "", shape, "");
    let all = errors(&text);
    let reported: Vec<String> = all.iter().map(|error| format!("{} {}", error.pointer, error.message)).collect();
    for words in [
        "/scene/numbers/b is computed from itself (a → b → a): break this cycle",
        "/scene/numbers/c ends too early: write a number, a name or a parenthesis here",
        "/scene/numbers/t stands for the time of the frame, in seconds, in every formula: use another name",
        "/scene/numbers/sin is the name of a function: use another",
        "/scene/numbers/x y cannot be named in formulas",
        "/scene/numbers/deep/keys is empty",
        "/scene/objects/0/shape/union/of/0/sphere/radius/expr none is not defined",
        "/scene/objects/0/shape/union/of/1/sphere/radius must be a size",
        "/scene/objects/0/shape/union/of/2/cube",
    ] {
        assert!(reported.iter().any(|reported| reported.starts_with(words)), "{words} is missing: {reported:#?}");
    }
    assert_eq!(all.len(), 9, "{reported:#?}");
}

#[test]
fn an_error_in_a_shape_with_numbers_is_at_the_shape() {
    let shapes = r#""ball": { "sphere": { "radius": { "expr": "girth" } } }"#;
    for (with, pointer, words) in [
        (r#""girth": -1"#, "/scene/shapes/ball/sphere/radius", "not -1"),
        (r#""girth": "1 /""#, "/scene/objects/0/shape/use/with/girth", "ends too early"),
        (r#""girth": 1, "grith": 2"#, "/scene/objects/0/shape/use/with/grith", "did you mean \"girth\"?"),
        (
            r#""girth": true"#,
            "/scene/objects/0/shape/use/with/girth",
            "must be a number, a formula as text, or a track",
        ),
    ] {
        let text = text("", shapes, &format!(r#"{{ "use": {{ "shape": "ball", "with": {{ {with} }} }} }}"#), "");
        let all = errors(&text);
        let [error] = &all[..] else { panic!("{with}: {all:?}") };
        assert!(error.pointer == pointer && error.message.contains(words), "{with}: {error}");
    }
    // An error of a shape that is used with many numbers is reported once.
    let uses: Vec<String> =
        (1..9).map(|k| format!(r#"{{ "use": {{ "shape": "ball", "with": {{ "girth": {k} }} }} }}"#)).collect();
    let wrong = shapes.replace("\"radius\"", "\"radios\": 1, \"radius\"");
    let all = errors(&text("", &wrong, &format!(r#"{{ "union": {{ "of": [{}] }} }}"#, uses.join(", ")), ""));
    assert!(all.len() == 1 && all[0].pointer == "/scene/shapes/ball/sphere/radios", "{all:?}");
    let cycle = r#""a": { "use": { "shape": "a", "with": { "r": "r / 2" } } }"#;
    let error = &errors(&text(r#""r": 1"#, cycle, r#"{ "use": "a" }"#, ""))[0];
    assert!(error.message.contains("makes \"a\" a part of itself"), "{error}");
}

#[test]
fn an_error_in_a_later_frame_names_it() {
    let frames = r#", "frames": { "count": 5, "fps": 2 }"#;
    let error = &errors(&text("", "", &sphere(r#"{ "expr": "1 - t" }"#), frames))[0];
    assert!(error.message.contains("must be a size") && error.message.contains("frame 2"), "{error}");
    let error = &errors(&text("", "", &sphere(r#"{ "expr": "1 / (1 - t)" }"#), frames))[0];
    assert!(error.message.contains("no finite value") && error.message.contains("frame 2"), "{error}");
}

#[test]
fn what_is_the_same_in_all_frames_takes_no_formula_of_time() {
    let copies =
        format!(r#"{{ "copies": {{ "child": {}, "at": [{{ "by": [{{ "expr": "t" }}, 0, 0] }}] }} }}"#, sphere("1"));
    let error = &errors(&text("", "", &copies, ""))[0];
    assert!(error.message.contains("without t, frame"), "{error}");
    let error = &errors(&text("", "", &sphere("1"), "").replace("\"width\": 8", r#""width": { "expr": "8 + t" }"#))[0];
    assert!(error.message.contains("without t, frame"), "{error}");
}

#[test]
fn formulas_are_bounded() {
    let long = format!("1{}", " + 1".repeat(300));
    let deep = format!("{}1{}", "(".repeat(40), ")".repeat(40));
    let signs = format!("{}1 + 2", "-".repeat(900));
    let powers = format!("1{}", "^1".repeat(450));
    for (formula, words) in [(&long, "bytes"), (&deep, "nests deeper")] {
        let error = &errors(&text("", "", &sphere(&format!(r#"{{ "expr": "{formula}" }}"#)), ""))[0];
        assert!(error.message.contains(words), "{error}");
    }
    assert_eq!(of_formula(&signs), 3.0);
    assert_eq!(of_formula(&powers), 1.0);
    // Names that double their size.
    let doubling: Vec<String> = (1..30).map(|k| format!(r#""a{k}": "a{} + a{}""#, k - 1, k - 1)).collect();
    let numbers = format!(r#""a0": "t", {}"#, doubling.join(", "));
    let error = &errors(&text(&numbers, "", &sphere(r#"{ "expr": "a29" }"#), ""))[0];
    assert!(error.message.contains("more than 1000 operations"), "{error}");
    // A chain of names.
    let chain: Vec<String> = (1..200).map(|k| format!(r#""a{}": "a{} + 1""#, 200 - k, 199 - k)).collect();
    let numbers = format!(r#"{}, "a0": "t""#, chain.join(", "));
    let error = &errors(&text(&numbers, "", &sphere("1"), ""))[0];
    assert!(error.message.contains("more than 32 other numbers"), "{error}");
}

#[test]
fn the_table_in_the_docs_lists_every_function() {
    let docs = include_str!("../../../docs/jobs.md");
    let rows: Vec<&str> = docs.lines().filter(|line| line.starts_with("| `") && line.contains(")` | ")).collect();
    let listed: Vec<String> = scene::FUNCTIONS
        .iter()
        .map(|function| format!("| `{}({})` | {} |", function.name, function.parameters, function.about))
        .collect();
    let start = rows.iter().position(|row| row.starts_with("| `sin(")).expect("the first function");
    assert_eq!(rows[start..start + listed.len()], listed);
    for (name, _) in scene::FORMULA_NAMES {
        assert!(docs.contains(&format!("`{name}`")), "{name} is not in the docs");
    }
}

#[test]
fn ten_thousand_formulas_are_read_in_bounded_steps() {
    // Copies at formulas of their own and of names; the time is in docs/benchmarks.md.
    let at: Vec<String> = (0..3_333)
        .map(|k| format!(r#"{{ "by": [{{ "expr": "gap * {k}" }}, {{ "expr": "sin(gap * {k})" }}, {{ "expr": "random({k})" }}] }}"#))
        .collect();
    let shape = format!(r#"{{ "copies": {{ "child": {}, "at": [{}] }} }}"#, sphere("0.1"), at.join(", "));
    let job = job(&text(r#""r": 0.2, "gap": "2 * r""#, "", &shape, ""));
    assert_eq!(job.nodes(), 3_334);
}

/// Texts whose work would grow with the square of their size, or exceed the stack.
#[test]
fn deep_and_large_texts_with_formulas_are_read_in_bounded_work() {
    let deep = |open: &str, close: &str| {
        let shape = format!("{}1{}", open.repeat(200_000), close.repeat(200_000));
        errors(&text(r#""r": 1"#, "", &shape, "")).iter().any(|error| error.message.contains("nests deeper"))
    };
    assert!(deep("[", "]") && deep(r#"{"a":"#, "}"));
    let unused: Vec<String> = (0..100_000).map(|k| format!(r#""s{k}": {}"#, sphere("1"))).collect();
    let job = job(&text(r#""r": 1"#, &unused.join(", "), &sphere(r#"{ "expr": "r" }"#), ""));
    assert_eq!(job.nodes(), 1);
}
