//! A line of text as outlines: glyphs of the embedded font, side by side.
//!
//! Lengths here are in ems: the size of the font is 1. The font is described in
//! `scene/picture/fonts/README.md`.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use ttf_parser::{Face, GlyphId, OutlineBuilder};

use super::Bounds2;
use super::bezier::{HalfParabola, QuadraticBezier};
use super::edge::Edge;

use crate::seek::{FrameTime, Seek, SeekError};

/// Maximum number of characters of a text.
const MAX_CHARACTERS: usize = 64;
/// Maximum number of lines and curves of a text's outlines.
const MAX_SEGMENTS: usize = 2_000;
/// Height of the center of a capital above the baseline.
const CAP_HEIGHT_CENTER: f32 = 0.364_5;

static FONT: &[u8] = include_bytes!("../../fonts/DejaVuSans-Bold-Latin.ttf");

/// A line of text and its outlines.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct TextOutline {
    string: String,
    letters: Vec<GlyphOutline>,
}

impl Seek for TextOutline {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        // The letters follow from the string alone.
        let Self { string, letters: _ } = self;
        string.seek(clock)
    }
}

/// Outline of one character at its position.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct GlyphOutline {
    pub(super) pieces: Vec<OutlineSegment>,
    pub(super) extent: Bounds2,
    /// A point of the outline, near its center.
    pub(super) anchor: [f32; 2],
}

/// Segment of an outline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum OutlineSegment {
    /// A straight segment.
    Line(Edge),
    /// A curve that is monotonic in y.
    Curve(HalfParabola),
}

/// Error returned when a text has no outline.
#[derive(Debug, thiserror::Error)]
pub enum TextOutlineError {
    /// The text has this many characters, more than the maximum.
    #[error("has {0} characters: use at most {MAX_CHARACTERS}")]
    TooLong(usize),
    /// A character that the font lacks.
    #[error("has {0:?}, which the font lacks: it has Latin letters, digits, punctuation and arrows")]
    NoGlyph(char),
    /// The outlines have this many segments, more than the maximum.
    #[error("has outlines of {0} lines and curves: use fewer letters, for at most {MAX_SEGMENTS}")]
    TooManySegments(usize),
    /// No character is visible.
    #[error("shows nothing: write a letter or more")]
    Blank,
}

impl TryFrom<String> for TextOutline {
    type Error = TextOutlineError;

    fn try_from(string: String) -> Result<Self, TextOutlineError> {
        let count = string.chars().count();
        if count > MAX_CHARACTERS {
            return Err(TextOutlineError::TooLong(count));
        }
        let letters = lay_out(&string)?;
        let pieces = letters.iter().map(|letter| letter.pieces.len()).sum();
        match pieces {
            0 => Err(TextOutlineError::Blank),
            1..=MAX_SEGMENTS => Ok(Self { string, letters }),
            _ => Err(TextOutlineError::TooManySegments(pieces)),
        }
    }
}

impl From<TextOutline> for String {
    fn from(outline: TextOutline) -> Self {
        outline.string
    }
}

impl JsonSchema for TextOutline {
    fn schema_name() -> Cow<'static, str> {
        "TextOutline".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "string", "minLength": 1, "maxLength": MAX_CHARACTERS,
            "description": "Latin letters, digits, punctuation and arrows."
        })
    }
}

impl TextOutline {
    /// Its visible letters, one or more.
    pub(super) fn letters(&self) -> &[GlyphOutline] {
        &self.letters
    }
}

/// Lays out a line of text, centered at x = 0, with half a capital's height at y = 0.
fn lay_out(string: &str) -> Result<Vec<GlyphOutline>, TextOutlineError> {
    let face = Face::parse(FONT, 0).expect("the embedded font is a font");
    let em = f32::from(face.units_per_em());
    let (mut pen, mut before, mut placed) = (0, None, Vec::new());
    for character in string.chars() {
        let glyph = face.glyph_index(character).ok_or(TextOutlineError::NoGlyph(character))?;
        pen += before.map_or(0, |before| kerning(&face, before, glyph));
        placed.push((glyph, pen));
        pen += i32::from(face.glyph_hor_advance(glyph).unwrap_or(0));
        before = Some(glyph);
    }
    let letters = placed.into_iter().filter_map(|(glyph, from)| {
        let left = (from as f32 - pen as f32 / 2.0) / em;
        let mut outline =
            OutlineCollector { scale: 1.0 / em, left, start: [0.0; 2], pen: [0.0; 2], pieces: Vec::new() };
        face.outline_glyph(glyph, &mut outline)?;
        GlyphOutline::new(outline.pieces)
    });
    Ok(letters.collect())
}

/// Adjustment of the distance between two neighbors, in the font's units.
fn kerning(face: &Face, left: GlyphId, right: GlyphId) -> i32 {
    let tables = face.tables().kern.iter().flat_map(|kern| kern.subtables);
    tables.filter_map(|table| table.glyphs_kerning(left, right)).map(i32::from).sum()
}

impl GlyphOutline {
    fn new(pieces: Vec<OutlineSegment>) -> Option<Self> {
        let extent = pieces.iter().map(OutlineSegment::extent).reduce(Bounds2::hull)?;
        let middle = [0, 1].map(|axis| (extent.low[axis] + extent.high[axis]) * 0.5);
        let off = |point: &[f32; 2]| (point[0] - middle[0]).abs() + (point[1] - middle[1]).abs();
        let anchor = pieces.iter().map(OutlineSegment::start).min_by(|a, b| off(a).total_cmp(&off(b)))?;
        Some(Self { pieces, extent, anchor })
    }
}

impl OutlineSegment {
    fn start(&self) -> [f32; 2] {
        match self {
            Self::Line(edge) => edge.from,
            Self::Curve(curve) => curve.start(),
        }
    }

    fn extent(&self) -> Bounds2 {
        match self {
            Self::Line(edge) => Bounds2::from_points([edge.from, edge.to]),
            Self::Curve(curve) => curve.extent(),
        }
    }
}

/// Collects a glyph's outline.
struct OutlineCollector {
    scale: f32,
    left: f32,
    start: [f32; 2],
    pen: [f32; 2],
    pieces: Vec<OutlineSegment>,
}

impl OutlineCollector {
    fn place(&self, x: f32, y: f32) -> [f32; 2] {
        [x * self.scale + self.left, y * self.scale - CAP_HEIGHT_CENTER]
    }

    fn line(&mut self, to: [f32; 2]) {
        if to != self.pen {
            self.pieces.push(OutlineSegment::Line(Edge::new(self.pen, to)));
        }
        self.pen = to;
    }

    /// Adds a curve, split at its vertex and at its vertical extremes.
    fn curve(&mut self, curve: QuadraticBezier) {
        // No split nearer to an end than this.
        const MIN_SEGMENT: f32 = 1e-3;
        let inside =
            [curve.vertex(), curve.extreme(1)].into_iter().find(|t| (MIN_SEGMENT..=1.0 - MIN_SEGMENT).contains(t));
        if curve.is_straight() {
            self.line(curve.to);
        } else if let Some(t) = inside {
            let [first, second] = curve.split(t);
            self.curve(first);
            self.curve(second);
        } else {
            self.pieces.push(OutlineSegment::Curve(HalfParabola::new(curve)));
            self.pen = curve.to;
        }
    }
}

impl OutlineBuilder for OutlineCollector {
    fn move_to(&mut self, x: f32, y: f32) {
        self.start = self.place(x, y);
        self.pen = self.start;
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.line(self.place(x, y));
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.curve(QuadraticBezier { from: self.pen, control: self.place(x1, y1), to: self.place(x, y) });
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        // A TrueType font has no cubic curves; this would be the nearest quadratic curve.
        let ([x1, y1], [x2, y2], [x, y]) = (self.place(x1, y1), self.place(x2, y2), self.place(x, y));
        let control = [(3.0 * (x1 + x2) - self.pen[0] - x) / 4.0, (3.0 * (y1 + y2) - self.pen[1] - y) / 4.0];
        self.curve(QuadraticBezier { from: self.pen, control, to: [x, y] });
    }

    fn close(&mut self) {
        self.line(self.start);
    }
}
