//! Test tile that a worker renders before it asks for work: a machine with incorrect results does not join the
//! farm.
//!
//! It is small, so that a worker still starts quickly; `sdfarm selftest` compares far more.

use anyhow::ensure;
use worker::Renderer;

use super::{hash, job, render, with_layers};

/// Shipped scene of the test tile.
const SCENE: &str = "csg";
/// Width of the test tile, in pixels.
const WIDTH_PX: u32 = 96;
/// Hash of the test tile's pixels, with every layer, on every device.
const EXPECTED_HASH: &str = "2ebe0e0856e986caad85e979ad506e86";

/// Renders the tile; an error if it differs from the expected bytes.
pub(crate) fn check(renderer: &dyn Renderer) -> anyhow::Result<()> {
    let job = with_layers(job(SCENE)?, Some(WIDTH_PX));
    let found = hash(&job, &render(renderer, &job, None)?);
    ensure!(
        found == EXPECTED_HASH,
        "{} does not render the expected bits: its test tile has hash {found}, not {EXPECTED_HASH}; run \
         `sdfarm selftest`, and do not use it in a farm until that succeeds",
        renderer.device()
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use worker::{CancelFlag, CpuRenderer, RenderError, Simd, TilePixels, TileRequest};

    /// Renderer with one incorrect bit.
    struct Bad(CpuRenderer);

    impl Renderer for Bad {
        fn device(&self) -> String {
            self.0.device()
        }

        fn render(
            &self,
            run: &TileRequest<'_>,
            cancel: &CancelFlag,
            progress: &(dyn Fn(u64) + Sync),
        ) -> Result<TilePixels, RenderError> {
            let mut pixels = self.0.render(run, cancel, progress)?;
            let value = pixels.planes[0].last_mut().expect("a pixel");
            *value = f32::from_bits(value.to_bits() ^ 1);
            Ok(pixels)
        }
    }

    #[test]
    fn valid_machine_passes_and_one_wrong_bit_does_not() {
        let correct = CpuRenderer::new(Some(1), Simd::Auto).expect("this machine renders");
        check(&correct).expect("the expected bits");
        let reported = check(&Bad(correct)).expect_err("an incorrect bit").to_string();
        assert!(reported.contains("does not render the expected bits"), "{reported}");
    }
}
