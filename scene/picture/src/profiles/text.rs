//! A line of text in the embedded font, as an outline.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::edge::EdgeScan;
use super::text_outline::{GlyphOutline, OutlineSegment, TextOutline};
use super::{Bounds2, ProfileSdf};
use crate::kinds::Exactness;
use crate::real::Real;
use crate::seek::Seek;
use crate::values::Length;

/// A line of bold sans-serif text, centered at the origin: half of its length along x, and half of a capital's height
/// along y.
///
/// It is exact unless letters overlap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Text {
    /// The text, up to 64 characters: Latin letters, digits, punctuation and arrows.
    pub string: TextOutline,
    /// Size of the font: capitals are 0.73 times as high.
    pub size: Length,
}

impl GlyphOutline {
    /// Squared distance to some point of the outline.
    fn distance_squared_upper_bound<R: Real>(&self, x: R, y: R) -> R {
        let [anchor_x, anchor_y] = self.anchor;
        (x - x.uniform(anchor_x)).square_add((y - x.uniform(anchor_y)).square())
    }

    /// Lower bound of the squared distance to the outline.
    fn distance_squared_lower_bound<R: Real>(&self, x: R, y: R) -> R {
        // Far more than rounding errors, so that every letter that may be nearest is evaluated.
        const MARGIN: f32 = 1e-4;
        let Bounds2 { low, high } = self.extent.widened(MARGIN);
        let beyond_x = (x.uniform(low[0]) - x).max(x - x.uniform(high[0])).at_least(0.0);
        let beyond_y = (x.uniform(low[1]) - y).max(y - x.uniform(high[1])).at_least(0.0);
        beyond_x.square_add(beyond_y.square())
    }

    /// Adds this letter to a scan. Outside its bounds a ray to the right crosses its closed outline an even number of
    /// times, so a letter that is too distant can be skipped.
    fn scan<R: Real>(&self, x: R, y: R, found: EdgeScan<R>) -> EdgeScan<R> {
        R::when(self.distance_squared_lower_bound(x, y).lt(found.0), found, || {
            let mut found = found;
            for piece in &self.pieces {
                found = match piece {
                    OutlineSegment::Line(edge) => edge.scan(x, y, found),
                    OutlineSegment::Curve(curve) => curve.pass(x, y, found),
                };
            }
            found
        })
    }
}

impl ProfileSdf for Text {
    const EXAMPLE: &str = r#"{ "string": "sdf", "size": 1 }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[r#"{ "string": "AV&Q8", "size": 0.6 }"#];

    fn distance<R: Real>(&self, x: R, y: R) -> R {
        let size = self.size.get();
        let (x, y) = (x * x.uniform(1.0 / size), y * x.uniform(1.0 / size));
        let mut nearest = x.constant(1e30);
        for letter in self.string.letters() {
            nearest = nearest.min(letter.distance_squared_upper_bound(x, y));
        }
        let mut found = (nearest, x.constant(1.0));
        for letter in self.string.letters() {
            found = letter.scan(x, y, found);
        }
        let (nearest, sign) = found;
        sign * nearest.sqrt() * x.uniform(size)
    }

    fn extent(&self, isolevel: f32) -> Bounds2 {
        let size = self.size.in_frame();
        let letters = self.string.letters().iter();
        let corners = letters.flat_map(|letter| [letter.extent.low, letter.extent.high]);
        Bounds2::from_points(corners.map(|corner| corner.map(|c| c * size))).widened(isolevel)
    }

    fn exactness(&self) -> Exactness {
        let letters = self.string.letters();
        let is_apart = letters.windows(2).all(|pair| pair[0].extent.high[0] < pair[1].extent.low[0]);
        if is_apart { Exactness::Exact } else { Exactness::Bound }
    }

    fn size_in_nodes(&self) -> u32 {
        // The GPU compiler needs long for them.
        const LINE: u32 = 1;
        const CURVE: u32 = 4;
        let pieces = self.string.letters().iter().flat_map(|letter| &letter.pieces);
        let weight = |piece: &OutlineSegment| match piece {
            OutlineSegment::Line(_) => LINE,
            OutlineSegment::Curve(_) => CURVE,
        };
        pieces.map(weight).sum()
    }
}
