//! Mattes: which objects or materials the samples of each pixel see, as compositing programs read them: Psyop,
//! "Cryptomatte specification", version 1.2.0, <https://github.com/Psyop/Cryptomatte>.
//!
//! A thing is identified by a hash of its name. Things of one name are one.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::animation::JobAtFrame;
use crate::film::Layer;
use crate::json_text;
use crate::json_text::ascii_json;

/// Maximum size of the list of names in a file; longer lists are left out.
const MAX_MANIFEST_BYTES: usize = 64 << 10;

/// The things that a layer tells apart.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Matte {
    layer: Layer,
    /// Names of the objects by their index, or of the materials by their slot.
    names: Vec<String>,
}

impl Matte {
    /// Ids, in the order of the names.
    pub fn ids(&self) -> Vec<u32> {
        self.names.iter().map(|name| id(name)).collect()
    }

    /// The layer that it is.
    pub fn layer(&self) -> Layer {
        self.layer
    }

    /// Attributes of an EXR that describe it: names and values, in ASCII.
    pub fn attributes(&self) -> Vec<(String, String)> {
        let channel = self.layer.channels().first().copied().unwrap_or_default();
        let name = channel.trim_end_matches("00.R");
        let key = format!("{:07x}", murmur3(name.as_bytes()) >> 4);
        let attribute = |part: &str, value: String| (format!("cryptomatte/{key}/{part}"), value);
        let mut attributes = vec![
            attribute("name", name.to_owned()),
            attribute("hash", "MurmurHash3_32".to_owned()),
            attribute("conversion", "uint32_to_float32".to_owned()),
        ];
        let by_name: BTreeMap<&str, String> =
            self.names.iter().map(|name| (&**name, format!("{:08x}", id(name)))).collect();
        let manifest = ascii_json(&by_name);
        if manifest.len() <= MAX_MANIFEST_BYTES {
            attributes.push(attribute("manifest", manifest));
        }
        attributes
    }
}

impl JobAtFrame<'_> {
    /// The mattes that the frame's picture has, in the order of its layers.
    pub fn mattes(&self) -> Vec<Matte> {
        let of_layer = |&layer: &Layer| {
            let names = match layer {
                Layer::CryptoObject => self.object_names(),
                Layer::CryptoMaterial => self.material_names(),
                Layer::Depth
                | Layer::Normal
                | Layer::Position
                | Layer::Albedo
                | Layer::Object
                | Layer::Steps
                | Layer::Samples
                | Layer::Noisy
                | Layer::Motion => return None,
            };
            Some(Matte { layer, names })
        };
        self.image().layers.iter().filter_map(of_layer).collect()
    }

    /// Names of the materials in use, by slot; of one without a name, its place in the job file.
    fn material_names(&self) -> Vec<String> {
        let name = |pointer: String| match pointer.strip_prefix("/scene/materials/") {
            Some(name) => json_text::unescape(name),
            None => pointer.trim_start_matches("/scene/").to_owned(),
        };
        (0..).map_while(|slot| self.job().material_pointer(slot)).map(name).collect()
    }

    /// Names of all objects; of one without a name, its index as messages have it.
    fn object_names(&self) -> Vec<String> {
        let objects = self.scene().objects.iter().enumerate();
        objects.map(|(index, object)| object.name.clone().unwrap_or_else(|| format!("object {index}"))).collect()
    }
}

/// Id of a name: the hash as the bits of a number that is finite and not subnormal.
fn id(name: &str) -> u32 {
    let hash = murmur3(name.as_bytes());
    let exponent = (hash >> 23) & 0xff;
    if exponent == 0 || exponent == 0xff { hash ^ (1 << 23) } else { hash }
}

/// `MurmurHash3_x86_32` with seed 0, by Austin Appleby: <https://github.com/aappleby/smhasher>.
fn murmur3(bytes: &[u8]) -> u32 {
    let mixed = |block: u32| block.wrapping_mul(0xcc9e_2d51).rotate_left(15).wrapping_mul(0x1b87_3593);
    let (blocks, tail) = bytes.as_chunks::<4>();
    let hash = blocks.iter().fold(0_u32, |hash, block| {
        (hash ^ mixed(u32::from_le_bytes(*block))).rotate_left(13).wrapping_mul(5).wrapping_add(0xe654_6b64)
    });
    let rest = tail.iter().rev().fold(0_u32, |rest, &byte| rest << 8 | u32::from(byte));
    let mut hash = hash ^ mixed(rest) ^ bytes.len() as u32;
    hash = (hash ^ (hash >> 16)).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ (hash >> 13)).wrapping_mul(0xc2b2_ae35);
    hash ^ (hash >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Test vectors of other implementations of the hash.
    #[test]
    fn hashes_are_those_of_murmur3() {
        for (text, hash) in [
            ("", 0),
            ("hello", 0x248b_fa47),
            ("hello, world", 0x149b_bb7f),
            ("The quick brown fox jumps over the lazy dog", 0x2e4f_f723),
            ("test", 0xba6b_d213),
            ("Hello, world!", 0xc036_3e43),
        ] {
            assert_eq!(murmur3(text.as_bytes()), hash, "{text}");
        }
    }

    #[test]
    fn ids_are_numbers_that_survive_any_program() {
        for index in 0..200_000 {
            let number = f32::from_bits(id(&format!("object {index}")));
            assert!(number.is_normal(), "{index}: {number}");
        }
    }
}
