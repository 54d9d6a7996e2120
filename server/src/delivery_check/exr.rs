//! Header of an EXR with one part of scan lines: "The OpenEXR File Layout",
//! <https://openexr.com/en/latest/OpenEXRFileLayout.html>.

use super::{ExpectedPicture, ExrChannel, ExrSample, FileEnds, take, take_until_zero};

/// The magic number, then version 2 without flags.
const START: &[u8] = &[0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
/// Compression of blocks of 16 rows by ZIP.
const ZIP16: &[u8] = &[3];
/// Rows compressed together.
const BLOCK_ROWS: u32 = 16;
/// Bytes of a block's place in the table of offsets, and before its pixels.
const MIN_BLOCK_BYTES: u64 = 16;

/// Checks a picture's dimensions, channels and provenance.
pub(super) fn check(file: &FileEnds, expected: &ExpectedPicture, wanted: &[ExrChannel]) -> Result<(), String> {
    let not_exr = || "the picture is not an EXR of this program".to_owned();
    let rest = &mut file.head.strip_prefix(START).ok_or_else(not_exr)?;
    let (mut size, mut found_channels, mut compression, mut provenance) = (None, None, None, None);
    loop {
        let name = take_until_zero(rest).ok_or_else(not_exr)?;
        if name.is_empty() {
            break;
        }
        let kind = take_until_zero(rest).ok_or_else(not_exr)?;
        let value =
            take_number(rest).and_then(|length| take(rest, usize::try_from(length).ok()?)).ok_or_else(not_exr)?;
        match (name, kind) {
            (b"dataWindow", b"box2i") => size = window_size(value),
            (b"channels", b"chlist") => found_channels = channels(value),
            (b"compression", b"compression") => compression = Some(value),
            (b"sdfarm", b"string") => provenance = Some(value),
            _ => {}
        }
    }
    let (width_px, height_px) = size.ok_or_else(not_exr)?;
    expected.expect_size(width_px, height_px)?;
    if found_channels.as_deref() != Some(wanted) || compression != Some(ZIP16) {
        return Err("the picture's channels or its compression are not those of the job".to_owned());
    }
    expected.expect_provenance(provenance)?;
    let header_bytes = (file.head.len() - rest.len()) as u64;
    let blocks = u64::from(height_px.div_ceil(BLOCK_ROWS));
    if file.size_bytes > header_bytes + blocks * MIN_BLOCK_BYTES {
        Ok(())
    } else {
        Err("the picture is incomplete".to_owned())
    }
}

fn take_number(rest: &mut &[u8]) -> Option<i32> {
    take(rest, 4)?.try_into().ok().map(i32::from_le_bytes)
}

/// Width and height of a window that starts at (0, 0); its corners belong to it.
fn window_size(mut value: &[u8]) -> Option<(u32, u32)> {
    let rest = &mut value;
    let mut corner = || Some((take_number(rest)?, take_number(rest)?));
    let (start, (right, bottom)) = (corner()?, corner()?);
    let length = |last: i32| u32::try_from(last).ok()?.checked_add(1);
    (start == (0, 0)).then_some((length(right)?, length(bottom)?))
}

fn channels(mut value: &[u8]) -> Option<Vec<ExrChannel>> {
    let rest = &mut value;
    let mut channels = Vec::new();
    loop {
        let name = take_until_zero(rest)?;
        if name.is_empty() {
            return rest.is_empty().then_some(channels);
        }
        let sample = match take_number(rest)? {
            1 => ExrSample::Half,
            2 => ExrSample::Float,
            _ => return None,
        };
        // Whether it is perceptually linear, three reserved bytes, and the spacing of its samples.
        let [_, _, _, _, spacing @ ..] = take(rest, 12)? else { return None };
        if spacing != [1, 0, 0, 0, 1, 0, 0, 0] {
            return None;
        }
        channels.push(ExrChannel { name: String::from_utf8(name.to_vec()).ok()?, sample });
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{ends, expected};
    use super::*;

    fn attribute(name: &str, kind: &str, value: &[u8]) -> Vec<u8> {
        [name.as_bytes(), b"\0", kind.as_bytes(), b"\0", &(value.len() as u32).to_le_bytes(), value].concat()
    }

    fn channel(name: &str, sample: i32) -> Vec<u8> {
        [name.as_bytes(), b"\0", &sample.to_le_bytes(), &[0; 4], &[1, 0, 0, 0, 1, 0, 0, 0]].concat()
    }

    fn picture(right: i32, sample_of_z: i32, provenance: &str) -> Vec<u8> {
        let window: Vec<u8> = [0, 0, right, 5].iter().flat_map(|number: &i32| number.to_le_bytes()).collect();
        let colors = ["A", "B", "G", "R"].map(|name| channel(name, 1)).concat();
        let list = [colors, channel("Z", sample_of_z), vec![0]].concat();
        [
            START.to_vec(),
            attribute("channels", "chlist", &list),
            attribute("compression", "compression", ZIP16),
            attribute("dataWindow", "box2i", &window),
            attribute("sdfarm", "string", provenance.as_bytes()),
            vec![0; 100],
        ]
        .concat()
    }

    #[test]
    fn an_exr_is_checked_by_its_header() {
        let expected = expected("exr");
        let provenance = expected.provenance.clone();
        let right = picture(7, 2, &provenance);
        assert_eq!(expected.check(&ends(&right)), Ok(()));
        for (wrong, reason) in [
            (b"\x89PNG\r\n\x1a\n".to_vec(), "not an EXR"),
            (right[..60].to_vec(), "not an EXR"),
            (right[..right.len() - 90].to_vec(), "incomplete"),
            (picture(8, 2, &provenance), "9×6 pixels instead of 8×6"),
            (picture(7, 1, &provenance), "channels"),
            (picture(7, 2, "{}"), "another scene"),
            ([right.clone(), vec![0; 600_000]].concat(), "at most"),
        ] {
            let error = expected.check(&ends(&wrong)).expect_err(reason);
            assert!(error.contains(reason), "{error} is not {reason}");
        }
    }

    #[test]
    fn no_damaged_header_panics() {
        let expected = expected("exr");
        let right = picture(7, 2, &expected.provenance);
        for at in 0..right.len() {
            drop(expected.check(&ends(&right[..at])));
            let mut wrong = right.clone();
            wrong[at] ^= 0xff;
            drop(expected.check(&ends(&wrong)));
        }
    }
}
