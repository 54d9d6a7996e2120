//! Tests of tracks.

use std::fmt;

use crate::limits::MAX_KEYFRAMES;
use crate::seek::{FrameTime, Seek};
use crate::values::{Color, Coordinate, Direction, Fraction, FrameRate, Length, LengthOrZero, Point, Rotation};

fn at<T: serde::de::DeserializeOwned + Seek>(seconds: f64, text: &str) -> T {
    let mut value: T = serde_json::from_str(text).unwrap_or_else(|error| panic!("{text}: {error}"));
    value.seek(&mut FrameTime::at(0, seconds)).unwrap_or_else(|misfit| panic!("{text}: {misfit:?}"));
    value
}

fn refusal<T: serde::de::DeserializeOwned + fmt::Debug>(text: &str) -> String {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    let error = serde_path_to_error::deserialize::<_, T>(&mut deserializer).expect_err(text);
    format!("{}: {}", error.path(), error.inner())
}

#[test]
fn a_track_clamps_at_its_ends_and_interpolates_between_keyframes() {
    let linear = |seconds| at::<Coordinate>(seconds, r#"{ "keys": [[1, 2], [3, 6], [4, -2]] }"#).in_frame();
    assert_eq!([0.0, 1.0, 1.5, 2.0, 3.0, 3.25, 4.0, 9.0].map(linear), [2.0, 2.0, 3.0, 4.0, 6.0, 4.0, -2.0, -2.0]);
    let step = |seconds| at::<Coordinate>(seconds, r#"{ "ease": "step", "keys": [[1, 2], [3, 6]] }"#).in_frame();
    assert_eq!([0.0, 2.9, 3.0, 5.0].map(step), [2.0, 2.0, 6.0, 6.0]);
    let smooth = |seconds| at::<Coordinate>(seconds, r#"{ "keys": [[0, 0], [4, 64]], "ease": "smooth" }"#).in_frame();
    assert_eq!([0.0, 1.0, 2.0, 3.0, 4.0].map(smooth), [0.0, 10.0, 32.0, 54.0, 64.0]);
}

#[test]
fn an_animated_number_is_animated_at_every_time() {
    const TRACK: &str = r#"{ "keys": [[0, 0], [2, 1]] }"#;
    let [first, later] = [0.0, 1.0].map(|seconds| at::<LengthOrZero>(seconds, TRACK));
    assert!(first.is_animated() && first.in_frame() == 0.0 && !first.is_zero());
    assert!(later.is_animated() && later.in_frame() == 0.5);
    assert!(at::<LengthOrZero>(0.0, "0").is_zero() && !at::<LengthOrZero>(0.0, "0").is_animated());
    assert!(!at::<Color>(0.0, &format!("[0, {TRACK}, 0]")).is_black() && at::<Color>(0.0, "[0, 0, 0]").is_black());
    assert_eq!(at::<Color>(1.0, &format!("[0, {TRACK}, 0]")).in_frame().y, 0.5);
    assert!(at::<Direction>(1.0, &format!("[1, {TRACK}, 0]")).is_animated());
    assert!(at::<Rotation>(1.0, &format!("[0, {TRACK}, 0]")).is_animated());
    assert_eq!(at::<Point>(1.0, &format!("[7, {TRACK}, 0]")).in_frame().y, 0.5);
}

#[test]
fn an_animated_number_survives_a_json_round_trip() {
    let number = at::<Length>(1.0, r#"{ "keys": [[0, 1], [4, 3]] }"#);
    let text = serde_json::to_string(&number).unwrap();
    let again = at::<Length>(9.0, &text);
    assert!(again.is_animated() && again.in_frame() == 1.5, "{text}");
    let color: Color = at(1.0, r#"[1, { "keys": [[0, 1], [4, 3]] }, 0]"#);
    let again: Color = serde_json::from_str(&serde_json::to_string(&color).unwrap()).unwrap();
    assert!(again.is_animated() && again.in_frame() == color.in_frame());
}

#[test]
fn a_value_between_0_and_the_minimum_snaps_to_one() {
    let amount = |seconds| at::<LengthOrZero>(seconds, r#"{ "keys": [[0, 0], [1, 1]] }"#).in_frame();
    assert_eq!(amount(1e-7), 0.0);
    assert_eq!(amount(0.5), 0.5);
    let amount = |seconds| at::<LengthOrZero>(seconds, r#"{ "keys": [[0, 0], [1, 1e-6]] }"#).in_frame();
    assert_eq!([0.25, 0.75].map(amount), [0.0, 1e-6]);
}

#[test]
fn an_error_in_a_track_has_its_pointer() {
    for (text, place, words) in [
        (r#"{ "keys": [] }"#, "keys", "needs a key"),
        (r#"{ "keys": [[0, 1], [2, -3]] }"#, "keys[1][1]", "from 1e-6"),
        (r#"{ "keys": [[0, 1], [2, 2], [2, 3]] }"#, "keys[2][0]", "order of time"),
        (r#"{ "keys": [[0, 1], ["2", 2]] }"#, "keys[1][0]", "seconds"),
        (r#"{ "keys": [[1e12, 1]] }"#, "keys[0][0]", "seconds"),
        (r#"{ "keys": [[0]] }"#, "keys[0]", "[seconds, number]"),
        (r#"{ "keys": [[0, 1, 2]] }"#, "keys[0][2]", "the name of an easing"),
        (r#"{ "keys": [[0, 1, "smooth"]] }"#, "keys[0]", "is the first key"),
        (r#"{ "keys": [[0, 1], [1, 2, "fast"]] }"#, "keys[1][2]", "ease_in"),
        (r#"{ "keys": [[0, 1], [1, 2, [2, 0, 1, 1]]] }"#, "keys[1][2]", "x1 and x2 from 0 to 1"),
        (r#"{ "keys": [[0, 1], [1, 2, [0, 0, 1]]] }"#, "keys[1][2]", "invalid length 3"),
        (r#"{ "keys": [[0, 1], [1, 2, "ease", 3]] }"#, "keys[1]", "[seconds, number, easing]"),
        (r#"{ "keys": [[0, { "keys": [[0, 1]] }]] }"#, "keys[0][1]", "a number"),
        (r#"{ "keys": [[0, 1]], "ease": "bounce" }"#, "ease", "smooth"),
        (r#"{ "keys": [[0, 1]], "loop": true }"#, "loop", "expected value"),
        (r#"{ "keys": [[0, 1]], "loop": "forever" }"#, "loop", "ping_pong"),
        (r#"{ "keys": [[0, 1]], "loops": "repeat" }"#, "loops", "unknown"),
        (r#"{ "ease": "linear" }"#, ".", "keys"),
        (r#""1""#, ".", "a number, a track"),
    ] {
        let reported = refusal::<Length>(text);
        assert!(reported.starts_with(&format!("{place}: ")) && reported.contains(words), "{text}: {reported}");
    }
    let long: Vec<String> = (0..=MAX_KEYFRAMES).map(|key| format!("[{key}, 1]")).collect();
    let reported = refusal::<Length>(&format!(r#"{{ "keys": [{}] }}"#, long.join(",")));
    assert!(reported.starts_with("keys: ") && reported.contains("10000"), "{reported}");
}

#[test]
fn frame_counts_cannot_be_tracks() {
    assert!(refusal::<FrameRate>(r#"{ "keys": [[0, 24]] }"#).contains("a number"));
}

fn number(seconds: f64, track: &str) -> f32 {
    at::<Coordinate>(seconds, track).in_frame()
}

#[test]
fn a_key_says_how_it_is_reached() {
    let track = r#"{ "keys": [[0, 0], [1, 1, "step"], [2, 5], [3, 0, "smooth"]], "ease": "linear" }"#;
    assert_eq!([0.5, 1.0, 1.25, 2.25].map(|seconds| number(seconds, track)), [0.0, 1.0, 2.0, 5.0 * 0.84375]);
}

/// The curves of CSS, whose values follow from their definition: a cubic Bézier's x gives the parameter of its y.
#[test]
fn easings_are_those_of_css() {
    let eased = |ease: &str| {
        let track = format!(r#"{{ "keys": [[0, 0], [1, 1, {ease}]] }}"#);
        [0.25, 0.5, 0.75].map(|seconds| number(seconds, &track))
    };
    let curve = |[x1, y1, x2, y2]: [f64; 4]| {
        [0.25, 0.5, 0.75].map(|x| {
            let of = |a: f64, b: f64, s: f64| {
                let rest = 1.0 - s;
                3.0 * rest * rest * s * a + 3.0 * rest * s * s * b + s * s * s
            };
            let s = (0..=1_000_000).map(|k| f64::from(k) * 1e-6).find(|s| of(x1, x2, *s) >= x).unwrap_or(1.0);
            of(y1, y2, s) as f32
        })
    };
    for (name, points) in [
        ("ease", [0.25, 0.1, 0.25, 1.0]),
        ("ease_in", [0.42, 0.0, 1.0, 1.0]),
        ("ease-in", [0.42, 0.0, 1.0, 1.0]),
        ("ease_out", [0.0, 0.0, 0.58, 1.0]),
        ("ease_in_out", [0.42, 0.0, 0.58, 1.0]),
        ("back_out", [0.34, 1.56, 0.64, 1.0]),
    ] {
        let (named, by_points) = (eased(&format!("\"{name}\"")), eased(&format!("{points:?}")));
        assert_eq!(named, by_points, "{name}");
        for (got, wanted) in named.into_iter().zip(curve(points)) {
            assert!((got - wanted).abs() < 1e-5, "{name}: {got}, not {wanted}");
        }
    }
    assert!(eased("\"back_out\"")[2] > 1.0 && eased("\"back_in\"")[0] < 0.0);
    assert_eq!(eased("[0, 0, 1, 1]").map(|share| (share * 1e6).round()), [250_000.0, 500_000.0, 750_000.0]);
    let bounce = [0.0, 4.0 / 11.0, 6.0 / 11.0, 8.0 / 11.0, 1.0];
    let bounce = bounce.map(|seconds| number(seconds, r#"{ "keys": [[0, 0], [1, 1, "bounce_out"]] }"#));
    assert_eq!(bounce, [0.0, 1.0, 0.75, 1.0, 1.0]);
}

#[test]
fn an_easing_beyond_the_range_stays_in_it() {
    let track = r#"{ "keys": [[0, 0], [1, 1, "back_out"]] }"#;
    assert!((0..=20).all(|step| at::<Fraction>(f64::from(step) / 20.0, track).in_frame() <= 1.0));
}

#[test]
fn a_loop_repeats_its_keys_or_goes_back_and_forth() {
    let repeat = r#"{ "keys": [[1, 0], [3, 4]], "loop": "repeat" }"#;
    let seconds = [1.0, 2.0, 2.5, 3.0, 4.0, 0.0, -0.5, 11.5];
    assert_eq!(seconds.map(|seconds| number(seconds, repeat)), [0.0, 2.0, 3.0, 0.0, 2.0, 2.0, 1.0, 1.0]);
    let back = r#"{ "keys": [[1, 0], [3, 4]], "loop": "ping_pong" }"#;
    assert_eq!(seconds.map(|seconds| number(seconds, back)), [0.0, 2.0, 3.0, 4.0, 2.0, 2.0, 3.0, 3.0]);
    let one = r#"{ "keys": [[1, 7]], "loop": "repeat" }"#;
    assert_eq!(number(9.0, one), 7.0);
}

#[test]
fn points_rotations_directions_and_colors_have_tracks() {
    let point = r#"{ "keys": [[0, [0, 1, 5]], [1, [2, 1, -5], "smooth"]] }"#;
    assert_eq!(<[f32; 3]>::from(at::<Point>(0.5, point).in_frame()), [1.0, 1.0, 0.0]);
    assert!(at::<Rotation>(0.5, point).is_animated());
    assert!(at::<Direction>(0.25, point).is_animated());
    let color = r##"{ "keys": [[0, "#000"], [1, [1, 0.5, 0]], [2, { "kelvin": 2000 }]] }"##;
    assert_eq!(<[f32; 3]>::from(at::<Color>(0.5, color).in_frame()), [0.5, 0.25, 0.0]);
    assert_eq!(at::<Color>(2.0, color).in_frame(), at::<Color>(0.0, r#"{ "kelvin": 2000 }"#).in_frame());
    let kelvin = r#"{ "kelvin": { "keys": [[0, 2000], [1, 8000]] } }"#;
    assert_eq!(at::<Color>(0.5, kelvin).in_frame(), at::<Color>(0.0, r#"{ "kelvin": 5000 }"#).in_frame());
    assert!(at::<Color>(0.5, kelvin).is_animated());
    for (text, place, words) in [
        (r#"{ "keys": [[0, [0, 1]]] }"#, "keys[0][1]", "invalid length 2"),
        (r#"{ "keys": [[0, 1]] }"#, "keys[0][1]", "an array of length 3"),
        (r#"{ "expr": "t" }"#, "", "a list of 3 numbers, each of which may be a formula"),
    ] {
        let reported = refusal::<Point>(text);
        assert!(reported.starts_with(place) && reported.contains(words), "{text}: {reported}");
    }
    assert!(refusal::<Color>(r#"{ "kelvin": 500 }"#).contains("from 1700 to 25000 kelvin"));
    assert!(
        refusal::<Color>(r#"{ "keys": [[0, { "kelvin": { "keys": [[0, 2000]] } }]] }"#).contains("write one color")
    );
}

#[test]
fn colors_are_written_as_in_css() {
    let color = |text: &str| <[f32; 3]>::from(at::<Color>(0.0, text).in_frame());
    assert_eq!(color(r##""#f80""##), color(r##""#ff8800""##));
    assert_eq!(color(r#""rgb(255, 136, 0)""#), color(r##""#ff8800""##));
    assert_eq!(color(r#""rgb(100% 0% 0%)""#), [1.0, 0.0, 0.0]);
    for wrong in ["#ff88", "#gg0000", "rgb(256, 0, 0)", "rgb(1, 2)", "rgb(1, 2, 3, 4)", "rgb(-1, 0, 0)", "red"] {
        assert!(refusal::<Color>(&format!("\"{wrong}\"")).contains("a color: "), "{wrong}");
    }
}
