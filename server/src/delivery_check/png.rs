//! Header and end of a PNG. Chunks: PNG Specification, third edition, section 5.

use super::{ExpectedPicture, FileEnds, take, take_until_zero};

const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";
/// The last chunk: its length, type and checksum.
const END: &[u8] = b"\0\0\0\0IEND\xae\x42\x60\x82";
/// Keyword of the text with the provenance.
const KEYWORD: &[u8] = b"sdfarm";

/// Checks a picture's type, dimensions and provenance.
pub(super) fn check(file: &FileEnds, expected: &ExpectedPicture, opaque: bool, bits: u8) -> Result<(), String> {
    let not_png = || "the picture is not a PNG of this program".to_owned();
    let rest = &mut file.head.strip_prefix(SIGNATURE).ok_or_else(not_png)?;
    let header = next_chunk(rest).filter(|(kind, _)| *kind == b"IHDR").ok_or_else(not_png)?.1;
    let header: [u8; 13] = header.try_into().map_err(|_| not_png())?;
    let [w0, w1, w2, w3, h0, h1, h2, h3, depth, color, compression, filter, interlace] = header;
    expected.expect_size(u32::from_be_bytes([w0, w1, w2, w3]), u32::from_be_bytes([h0, h1, h2, h3]))?;
    let wanted_color = if opaque { 2 } else { 6 };
    if [depth, color, compression, filter, interlace] != [bits, wanted_color, 0, 0, 0] {
        return Err(format!(
            "the picture's pixels are of type {color} with {depth} bits instead of type {wanted_color} with {bits}"
        ));
    }
    let mut provenance = None;
    while rest.get(4..8) != Some(b"IDAT") {
        let (kind, content) = next_chunk(rest).ok_or_else(not_png)?;
        if kind == b"iTXt" {
            provenance = provenance.or_else(|| provenance_in(content));
        }
    }
    expected.expect_provenance(provenance)?;
    if &*file.tail == END { Ok(()) } else { Err("the picture is incomplete".to_owned()) }
}

/// Type and content of the next chunk.
fn next_chunk<'a>(rest: &mut &'a [u8]) -> Option<(&'a [u8; 4], &'a [u8])> {
    let length = u32::from_be_bytes(take(rest, 4)?.try_into().ok()?);
    let kind = take(rest, 4)?.try_into().ok()?;
    let content = take(rest, usize::try_from(length).ok()?)?;
    take(rest, 4)?;
    Some((kind, content))
}

/// Text of an international text chunk, if its keyword is that of the provenance.
fn provenance_in(mut chunk: &[u8]) -> Option<&[u8]> {
    let rest = &mut chunk;
    let keyword = take_until_zero(rest)?;
    let flags = take(rest, 2)?;
    take_until_zero(rest)?;
    take_until_zero(rest)?;
    (keyword == KEYWORD && flags == [0, 0]).then_some(*rest)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{ends, expected};
    use super::*;

    fn chunk(kind: [u8; 4], content: &[u8]) -> Vec<u8> {
        [&(content.len() as u32).to_be_bytes(), kind.as_slice(), content, &[0; 4]].concat()
    }

    fn picture(width_px: u32, color: u8, provenance: &str) -> Vec<u8> {
        let header = [&width_px.to_be_bytes()[..], &6_u32.to_be_bytes(), &[8, color, 0, 0, 0]].concat();
        let text = [b"sdfarm\0\0\0\0\0", provenance.as_bytes()].concat();
        [SIGNATURE, &chunk(*b"IHDR", &header), &chunk(*b"iTXt", &text), &chunk(*b"IDAT", &[7; 20]), END].concat()
    }

    #[test]
    fn a_png_is_checked_by_its_header_and_its_end() {
        let expected = expected("png");
        let provenance = expected.provenance.clone();
        let right = picture(8, 2, &provenance);
        assert_eq!(expected.check(&ends(&right)), Ok(()));
        for (wrong, reason) in [
            (b"<html></html>".to_vec(), "not a PNG"),
            (Vec::new(), "not a PNG"),
            (right[..right.len() - 1].to_vec(), "incomplete"),
            (right[..40].to_vec(), "not a PNG"),
            (picture(9, 2, &provenance), "9×6 pixels instead of 8×6"),
            (picture(8, 6, &provenance), "type 6"),
            (picture(8, 2, "{}"), "another scene"),
            ([right.clone(), vec![0; 600_000]].concat(), "at most"),
        ] {
            let error = expected.check(&ends(&wrong)).expect_err(reason);
            assert!(error.contains(reason), "{error} is not {reason}");
        }
    }

    #[test]
    fn no_damaged_header_panics() {
        let expected = expected("png");
        let right = picture(8, 2, &expected.provenance);
        for at in 0..right.len() {
            drop(expected.check(&ends(&right[..at])));
            let mut wrong = right.clone();
            wrong[at] ^= 0xff;
            drop(expected.check(&ends(&wrong)));
        }
    }
}
