//! Solids swept from a profile: along z, or around y.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Exactness, NodeError, Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::profiles::Profile;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Coordinate, Length, LengthOrZero};

/// A profile extruded along z, centered at z = 0.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>. It is as exact as the profile
/// if `round` is 0. With rounded edges it is a bound: near the profile's corners the distance is an underestimate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Extrude {
    /// The profile, in the plane of x and y.
    pub profile: Profile,
    /// Full height along z.
    pub height: Length,
    /// Radius of the rounded edges around both ends, inside the sharp solid.
    #[serde(default = "default_round")]
    pub round: LengthOrZero,
}

/// A profile rotated about the y axis.
///
/// Inigo Quilez, "Distance functions": <https://iquilezles.org/articles/distfunctions/>. The part of the profile
/// beyond the axis is cut off; the distance is then a bound, unless the profile is symmetric about the axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Revolve {
    /// The profile: its y is the axis, its x points away from the axis.
    pub profile: Profile,
    /// Distance of the profile's origin from the axis.
    #[serde(default = "default_offset")]
    pub offset: Coordinate,
}

impl Sdf for Extrude {
    const EXAMPLE: &'static str =
        r#"{ "profile": { "star": { "points": 5, "outer": 1.1, "inner": 0.55 } }, "height": 0.6, "round": 0.1 }"#;

    fn examples() -> Vec<String> {
        let profiles = Profile::examples().into_iter();
        let of_profiles = profiles.map(|profile| format!(r#"{{ "profile": {}, "height": 0.6 }}"#, profile.json));
        std::iter::once(Self::EXAMPLE.to_owned()).chain(of_profiles).collect()
    }

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, _: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let round = self.round.get();
        let past_outline = self.profile.sample(p.x, p.y) + p.x.uniform(round);
        let past_end = p.z.abs() - p.x.uniform(self.height.get() / 2.0 - round);
        let (out, up) = (past_outline.at_least(0.0), past_end.at_least(0.0));
        V::new(out.square_add(up.square()).sqrt() + past_outline.max(past_end).at_most(0.0) - p.x.uniform(round))
    }

    // Its factor is 1, rounded or not: it is a norm of two values: one changes with x and y alone and the
    // other with z alone, neither faster than the point.
    fn own_exactness(&self) -> Exactness {
        let worst_rounding = if self.round.in_frame() == 0.0 { Exactness::Exact } else { Exactness::Bound };
        self.profile.exactness().max(worst_rounding)
    }

    fn validate(&self) -> Option<NodeError> {
        let most = self.height.in_frame() / 2.0;
        let message = format!("must be at most half of the height: make round {most} or less");
        let round = (self.round.in_frame() > most).then(|| NodeError::new("round", message));
        profile_error(&self.profile).or(round)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (extent, up) = (self.profile.extent(isolevel), self.height.in_frame() / 2.0 + isolevel);
        let ([low_x, low_y], [high_x, high_y]) = (extent.low, extent.high);
        Bounds { min: vec3(low_x, low_y, -up), max: vec3(high_x, high_y, up) }
    }

    fn size_in_nodes(&self) -> u32 {
        self.profile.size_in_nodes()
    }
}

impl Sdf for Revolve {
    const EXAMPLE: &'static str =
        r#"{ "profile": { "star": { "points": 5, "outer": 0.5, "inner": 0.25 } }, "offset": 0.7 }"#;

    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "profile": { "polygon": { "points": [[0, -1.1], [0.7, -1], [0.85, -0.5], [0.3, 0.3], [0.25, 0.7], [0.5, 1], [0.4, 1.05],
            [0.1, 0.7], [0.15, 0.2], [0.7, -0.55], [0.6, -0.85], [0, -0.95]] } } }"#,
        r#"{ "profile": { "bezier": { "points": [[-0.1, -0.6], [0.9, -0.7], [0.5, 0.5]], "thickness": 0.12 } }, "offset": 0.3 }"#,
        r#"{ "profile": { "regular_polygon": { "sides": 5, "radius": 1 } } }"#,
        r#"{ "profile": { "arc": { "radius": 0.8, "degrees": 220, "thickness": 0.2 } } }"#,
        r#"{ "profile": { "circle": { "radius": 0.7 } }, "offset": -0.25 }"#,
        r#"{ "profile": { "text": { "string": "S", "size": 0.9 } }, "offset": 0.6 }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, _: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let from_axis = p.x.square_add(p.z.square()).sqrt();
        V::new(self.profile.sample(from_axis - p.x.uniform(self.offset.get()), p.y))
    }

    fn own_exactness(&self) -> Exactness {
        let offset = self.offset.in_frame();
        let is_whole =
            self.profile.extent(0.0).low[0] + offset >= 0.0 || (offset == 0.0 && self.profile.is_symmetric());
        let worst_cut = if is_whole { Exactness::Exact } else { Exactness::Bound };
        self.profile.exactness().max(worst_cut)
    }

    fn validate(&self) -> Option<NodeError> {
        let reach = self.profile.extent(0.0).high[0];
        let message = format!("puts the whole profile beyond the axis: make offset more than {}", -reach);
        let beyond = (self.offset.in_frame() + reach <= 0.0).then(|| NodeError::new("offset", message));
        profile_error(&self.profile).or(beyond)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let extent = self.profile.extent(isolevel);
        let across = (extent.high[0] + self.offset.in_frame()).max(0.0);
        Bounds { min: vec3(-across, extent.low[1], -across), max: vec3(across, extent.high[1], across) }
    }

    fn size_in_nodes(&self) -> u32 {
        self.profile.size_in_nodes()
    }
}

/// Error in the profile, with its pointer in the node around it.
fn profile_error(profile: &Profile) -> Option<NodeError> {
    let NodeError { pointer: place, message } = profile.validate()?;
    Some(NodeError::new(format!("profile/{}/{place}", profile.name()), message))
}

fn default_round() -> LengthOrZero {
    LengthOrZero::new(0.0).expect("0 is in range")
}

fn default_offset() -> Coordinate {
    Coordinate::new(0.0).expect("0 is in range")
}
