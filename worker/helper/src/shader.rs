//! Program of an approximate picture: a job's frame in WGSL, for a browser.

use proto::preview_helper::ShaderView;
use scene::limits::MAX_EDGE_PX;
use scene::{Bits, Film, Format, Job};
use worker::wgsl::{Shader, ShaderError};

/// Program and inputs of a frame at this width, with a height in proportion. The text is left out if the client has it.
pub(super) fn of(
    mut job: Job,
    frame: u32,
    width_px: Option<u32>,
    samples: u32,
    known: Option<&str>,
) -> anyhow::Result<ShaderView> {
    let image = &mut job.image;
    let Film { width: full_width, height, .. } = image.film();
    let width = width_px.unwrap_or(full_width);
    let height = (u64::from(height) * u64::from(width) + u64::from(full_width) / 2) / u64::from(full_width);
    image.resize(width, height.clamp(1, MAX_EDGE_PX.into()) as u32);
    (image.format, image.bits, image.samples) = (Format::Png, Bits::Eight, samples.into());
    image.clear_layers();
    let Film { width, height, .. } = image.film();
    let at_frame = job.at(frame)?;
    let none = ShaderView {
        program: String::new(),
        wgsl: None,
        uniforms: Vec::new(),
        table: Vec::new(),
        samples,
        width,
        height,
        exact: false,
        reason: None,
    };
    match Shader::new(&at_frame) {
        Ok(Shader { text, numbers, words }) => {
            let program = blake3::hash(text.as_bytes()).to_hex().to_string();
            let wgsl = (known != Some(&*program)).then_some(text);
            Ok(ShaderView { program, wgsl, uniforms: numbers, table: words, ..none })
        }
        Err(refusal @ (ShaderError::ManyShapes(_) | ShaderError::LongText(_))) => {
            Ok(ShaderView { reason: Some(refusal.to_string()), ..none })
        }
        Err(error @ ShaderError::Invalid(_)) => Err(error.into()),
    }
}
