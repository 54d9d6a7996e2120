//! Test tile that a worker renders before it asks for work: a machine with wrong results does not join the
//! farm.
//!
//! It is small, so that a worker still starts quickly; `sdfarm selftest` compares far more.

use anyhow::ensure;
use worker::Renderer;

use super::{hash, job, render, with_layers};

/// The shipped scene that it shows.
const SCENE: &str = "csg";
/// Its width.
const WIDTH_PX: u32 = 96;
/// The hash of its pixels, with every layer, on every device.
const EXPECTED_HASH: &str = "f8a67db79d18e1a055baa4c90ea3f297";

/// Renders the tile; an error if it differs from the expected bytes.
pub(crate) fn check(renderer: &dyn Renderer) -> anyhow::Result<()> {
    let job = with_layers(job(SCENE)?, Some(WIDTH_PX));
    let found = hash(&job, &render(renderer, &job, None)?);
    ensure!(
        found == EXPECTED_HASH,
        "{} does not render the right bits: its first tile is {found}, and should be {EXPECTED_HASH}; look into it with \
         `sdfarm selftest`, and let it render for no farm until that succeeds",
        renderer.device()
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use worker::{CancelFlag, CpuRenderer, RenderError, Simd, TilePixels, TileRequest};

    /// One bit of what it renders is wrong.
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
        let sound = CpuRenderer::new(Some(1), Simd::Auto).expect("this machine renders");
        check(&sound).expect("the right bits");
        let told = check(&Bad(sound)).expect_err("a wrong bit").to_string();
        assert!(told.contains("does not render the right bits"), "{told}");
    }
}
