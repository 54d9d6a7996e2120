//! Easing: how a number goes from one keyframe to the next.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::StrDeserializer;
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// How a number goes from one keyframe to the next, by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NamedEase {
    /// At a constant rate.
    #[default]
    Linear,
    /// With a smooth start and end: s²(3 − 2s) for the share s of the time.
    Smooth,
    /// Not at all before the next keyframe.
    Step,
    /// As `ease` in CSS: a quick start and a smooth end.
    Ease,
    /// As `ease-in` in CSS: a smooth start.
    EaseIn,
    /// As `ease-out` in CSS: a smooth end.
    EaseOut,
    /// As `ease-in-out` in CSS: a smooth start and end.
    EaseInOut,
    /// First a little the other way.
    BackIn,
    /// Beyond the keyframe, and back to it.
    BackOut,
    /// First a little the other way, then beyond the keyframe.
    BackInOut,
    /// Falls onto the keyframe, and bounces three times.
    BounceOut,
    /// As `bounce_out`, backward.
    BounceIn,
}

/// How a number goes from one keyframe to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ease {
    /// By name.
    Named(NamedEase),
    /// By a Bézier curve from (0, 0) to (1, 1) with these two control points, as `cubic-bezier` in CSS.
    Bezier([f64; 4]),
}

impl Default for Ease {
    fn default() -> Self {
        Self::Named(NamedEase::default())
    }
}

impl Ease {
    /// The share of the way, for a share of the time from 0 to 1.
    pub(super) fn apply(self, share: f64) -> f64 {
        // The curves of CSS are as in <https://www.w3.org/TR/css-easing-1/>; the curves of `back` approximate the usual
        // cubic with an overshoot of 10 % (<https://easings.net>).
        let curve = match self {
            Self::Bezier(curve) => curve,
            Self::Named(name) => match name {
                NamedEase::Linear => return share,
                NamedEase::Smooth => return share * share * (3.0 - 2.0 * share),
                NamedEase::Step => return 0.0,
                NamedEase::Ease => [0.25, 0.1, 0.25, 1.0],
                NamedEase::EaseIn => [0.42, 0.0, 1.0, 1.0],
                NamedEase::EaseOut => [0.0, 0.0, 0.58, 1.0],
                NamedEase::EaseInOut => [0.42, 0.0, 0.58, 1.0],
                NamedEase::BackIn => [0.36, 0.0, 0.66, -0.56],
                NamedEase::BackOut => [0.34, 1.56, 0.64, 1.0],
                NamedEase::BackInOut => [0.68, -0.6, 0.32, 1.6],
                NamedEase::BounceOut => return bounce(share),
                NamedEase::BounceIn => return 1.0 - bounce(1.0 - share),
            },
        };
        bezier(curve, share)
    }
}

/// The height of a Bézier curve from (0, 0) to (1, 1) at a horizontal position, by bisection.
fn bezier([x1, y1, x2, y2]: [f64; 4], share: f64) -> f64 {
    let at = |a: f64, b: f64, s: f64| {
        let rest = 1.0 - s;
        3.0 * rest * rest * s * a + 3.0 * rest * s * s * b + s * s * s
    };
    if share <= 0.0 || share >= 1.0 {
        return share.clamp(0.0, 1.0);
    }
    let (mut low, mut high) = (0.0, 1.0);
    // Halved until the two are neighbors.
    for _ in 0..54 {
        let middle = 0.5 * (low + high);
        if at(x1, x2, middle) < share {
            low = middle;
        } else {
            high = middle;
        }
    }
    at(y1, y2, 0.5 * (low + high))
}

/// A fall and three bounces, each a parabola.
fn bounce(share: f64) -> f64 {
    let parabola = |middle: f64, height: f64| 7.5625 * (share - middle) * (share - middle) + height;
    match share * 2.75 {
        time if time < 1.0 => parabola(0.0, 0.0),
        time if time < 2.0 => parabola(1.5 / 2.75, 0.75),
        time if time < 2.5 => parabola(2.25 / 2.75, 0.9375),
        _ => parabola(2.625 / 2.75, 0.984_375).min(1.0),
    }
}

struct EaseVisitor;

impl<'de> Visitor<'de> for EaseVisitor {
    type Value = Ease;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the name of an easing, or a Bézier curve [x1, y1, x2, y2]")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Ease, E> {
        // Names as in CSS are accepted, too.
        let name = name.replace('-', "_");
        NamedEase::deserialize(StrDeserializer::new(&name)).map(Ease::Named)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Ease, A::Error> {
        let mut curve = [0.0; 4];
        for (index, number) in curve.iter_mut().enumerate() {
            *number = list.next_element::<f64>()?.ok_or_else(|| A::Error::invalid_length(index, &self))?;
        }
        if list.next_element::<f64>()?.is_some() {
            return Err(A::Error::invalid_length(5, &self));
        }
        let [x1, y1, x2, y2] = curve;
        if ![x1, x2].iter().all(|x| (0.0..=1.0).contains(x)) || ![y1, y2].iter().all(|y| y.abs() <= 10.0) {
            return Err(A::Error::custom("must have x1 and x2 from 0 to 1, and y1 and y2 within ±10"));
        }
        Ok(Ease::Bezier(curve))
    }
}

impl<'de> Deserialize<'de> for Ease {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(EaseVisitor)
    }
}

impl Serialize for Ease {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Named(name) => name.serialize(serializer),
            Self::Bezier(curve) => curve.serialize(serializer),
        }
    }
}

impl JsonSchema for Ease {
    fn schema_name() -> Cow<'static, str> {
        "Ease".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let name = generator.subschema_for::<NamedEase>();
        let share = || serde_json::json!({ "type": "number", "minimum": 0, "maximum": 1 });
        let way = || serde_json::json!({ "type": "number", "minimum": -10, "maximum": 10 });
        json_schema!({
            "description": "How a number goes from one keyframe to the next: a name, or a Bézier curve [x1, y1, x2, y2] from (0, 0) to (1, 1), as cubic-bezier in CSS.",
            "anyOf": [
                name,
                {
                    "type": "array", "minItems": 4, "maxItems": 4,
                    "prefixItems": [share(), way(), share(), way()], "items": { "type": "number" }
                }
            ]
        })
    }
}
