//! Pictures and blobs without pixels: with a valid header, as the server checks it, and a text.

use proto::Rect;
use scene::{Bits, Format, Job, Precision};

/// Marks the text in a picture.
const MARK: &[u8] = b"text\0";
/// Bytes after the text in a PNG: a checksum, a chunk of data and the last chunk.
const PNG_END: &[u8] = b"\0\0\0\0\0\0\0\x01IDAT\0\0\0\0\0\0\0\0\0IEND\xae\x42\x60\x82";

/// Picture of a frame with a text. A text that is longer than the header is shortened, so that the file is as long
/// as the text was.
pub(crate) fn picture(job: &Job, frame: u32, text: &[u8]) -> Vec<u8> {
    let (head, end): (Vec<u8>, &[u8]) = match job.image.format {
        Format::Png => (png_head(job, frame), PNG_END),
        Format::Exr => (exr_head(job, frame), &[]),
    };
    let around = head.len() + 8 + MARK.len() + end.len();
    let text = if text.len() > around { &text[..text.len() - around] } else { text };
    let length = (MARK.len() + text.len()) as u32;
    [&head, &length.to_be_bytes()[..], b"tEXt", MARK, text, end].concat()
}

/// Text of a picture.
pub(crate) fn text_of(picture: &[u8]) -> String {
    let mark = [&b"tEXt"[..], MARK].concat();
    let at = picture.windows(mark.len()).position(|window| window == mark).expect("a picture with a text");
    let length = u32::from_be_bytes(picture[at - 4..at].try_into().expect("four bytes")) as usize;
    let text = &picture[at + mark.len()..at + 4 + length];
    String::from_utf8(text.to_vec()).expect("a text")
}

/// Blob of a tile: zeros, except for a text.
pub(crate) fn blob(job: &Job, rect: Rect, text: &[u8]) -> Vec<u8> {
    let planes = job.image.film().channels().len() as u32;
    let mut bytes = b"sdfb".to_vec();
    let fields = [1, rect.x, rect.y, rect.width, rect.height, planes];
    bytes.extend(fields.iter().flat_map(|field| field.to_le_bytes()));
    let size = bytes.len() + rect.pixels() as usize * planes as usize * 4;
    bytes.extend(text);
    bytes.resize(size, 0);
    bytes
}

fn provenance(job: &Job, frame: u32) -> String {
    let at_frame = job.at(frame).expect("a valid frame");
    let (scene, seed, version) = (at_frame.scene_hash().to_hex(), at_frame.image().seed, scene::PICTURE_VERSION);
    format!(r#"{{"scene":"{scene}","picture_version":{version},"frame":{frame},"seed":{seed}}}"#)
}

fn png_head(job: &Job, frame: u32) -> Vec<u8> {
    let chunk =
        |kind: &[u8], content: &[u8]| [&(content.len() as u32).to_be_bytes()[..], kind, content, &[0; 4]].concat();
    let bits = match job.image.bits {
        Bits::Eight => 8,
        Bits::Sixteen => 16,
    };
    let color = if job.is_transparent() { 6 } else { 2 };
    let size = [job.image.width, job.image.height].map(u32::to_be_bytes).concat();
    let header = [&size[..], &[bits, color, 0, 0, 0]].concat();
    let text = [b"sdfarm\0\0\0\0\0", provenance(job, frame).as_bytes()].concat();
    [b"\x89PNG\r\n\x1a\n", &*chunk(b"IHDR", &header), &chunk(b"iTXt", &text)].concat()
}

fn exr_head(job: &Job, frame: u32) -> Vec<u8> {
    let attribute = |name: &str, kind: &str, value: &[u8]| {
        [name.as_bytes(), b"\0", kind.as_bytes(), b"\0", &(value.len() as u32).to_le_bytes(), value].concat()
    };
    let color = if job.image.precision == Precision::Half { 1 } else { 2 };
    let mut channels: Vec<(String, i32)> = job
        .image
        .film()
        .channels()
        .into_iter()
        .enumerate()
        .map(|(plane, name)| (name.into_owned(), if plane < job.image.film().light_channels() { color } else { 2 }))
        .collect();
    channels.sort_unstable();
    let mut list: Vec<u8> = channels
        .iter()
        .flat_map(|(name, sample)| {
            [name.as_bytes(), b"\0", &sample.to_le_bytes(), &[0; 4], &[1, 0, 0, 0, 1, 0, 0, 0]].concat()
        })
        .collect();
    list.push(0);
    let corner = [0, 0, job.image.width - 1, job.image.height - 1].map(u32::to_le_bytes).concat();
    [
        vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0],
        attribute("channels", "chlist", &list),
        attribute("compression", "compression", &[3]),
        attribute("dataWindow", "box2i", &corner),
        attribute("sdfarm", "string", provenance(job, frame).as_bytes()),
        vec![0; 1 + 16 * job.image.height.div_ceil(16) as usize],
    ]
    .concat()
}
