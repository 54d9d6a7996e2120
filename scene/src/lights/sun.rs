//! The sun of a background that has one.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Exemplary, Incoming, LightSource, full, wide, yes};
use crate::backgrounds::{Backdrop, Background, Day};
use crate::nodes::NodeFault;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Aperture, Strength};

/// The sun of the background's `day`: its direction and its colour come from there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Sun {
    /// How bright it is beside the sky.
    #[serde(default = "full")]
    pub strength: Strength,
    /// How wide it is, in degrees.
    #[serde(default = "sun_wide")]
    pub angle: Aperture,
    /// Whether things cast shadows in it.
    #[serde(default = "yes")]
    pub shadow: bool,
}

impl Exemplary for Sun {
    const EXAMPLE: &'static str = "{}";
    const MORE: &'static [&'static str] = &[r#"{ "strength": 0.6, "angle": 9 }"#];
}

impl LightSource for Sun {
    #[inline(always)]
    fn arriving<R: Real>(
        &self,
        p: Vec3<R>,
        farthest: R,
        day: Option<&Day>,
        pair: impl FnOnce() -> (R, R),
    ) -> Option<(Incoming<R>, R)> {
        let day = day?;
        let direction = wide(p.x, day.sun.unit(), &self.angle, pair);
        let (color, strength) = (day.sun_color(), self.strength.get());
        let radiance = Vec3::given(p.x, color.map(|channel| channel * strength));
        Some((Incoming { direction, radiance }, farthest))
    }

    fn casts_shadows(&self) -> bool {
        self.shadow
    }

    fn is_dark(&self) -> bool {
        self.strength.is_zero()
    }

    fn fault(&self, background: &Background) -> Option<NodeFault> {
        background.day().is_none().then(|| {
            NodeFault::new("", "shines only by day: make the background a `day`, or use a `directional` light")
        })
    }
}

fn sun_wide() -> Aperture {
    Aperture::new(0.53).expect("0.53 is in range")
}
