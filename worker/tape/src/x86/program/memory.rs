//! Memory that machine code reads and writes: packets, so that every vector is aligned.

#[cfg(test)]
use super::guarded::Pages;
use super::{Packet, WORDS};

/// Memory of machine code.
#[derive(Debug)]
pub(super) struct Memory {
    place: Backing,
    /// Bytes that the code may touch.
    bytes: usize,
}

#[derive(Debug)]
enum Backing {
    Heap(Vec<Packet>),
    /// Pages between others that can't be touched.
    #[cfg(test)]
    Guarded(Pages),
}

impl Memory {
    /// Memory of zeros.
    pub(super) fn zeroed(packets: usize) -> Self {
        let bytes = packets * size_of::<Packet>();
        Self { place: Backing::Heap(vec![Packet([0.0; WORDS]); packets]), bytes }
    }

    /// The same memory; code touches only its first bytes.
    pub(super) fn limited(self, bytes: usize) -> Self {
        debug_assert!(bytes <= self.bytes, "{bytes} bytes in {}", self.bytes);
        Self { bytes, ..self }
    }

    /// The same content between pages that can't be touched.
    #[cfg(test)]
    pub(super) fn guarded(self, edge: super::guarded::Edge) -> Self {
        let Backing::Heap(packets) = self.place else { return self };
        Self { place: Backing::Guarded(Pages::new(&packets, self.bytes, edge)), bytes: self.bytes }
    }

    /// Bytes that code may touch.
    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    pub(super) fn address(&self) -> *const Packet {
        match &self.place {
            Backing::Heap(packets) => packets.as_ptr(),
            #[cfg(test)]
            Backing::Guarded(pages) => pages.address().cast(),
        }
    }

    /// All packets of a memory that consists of whole ones.
    pub(super) fn packets(&mut self) -> &mut [Packet] {
        match &mut self.place {
            Backing::Heap(packets) => packets,
            #[cfg(test)]
            Backing::Guarded(pages) => pages.packets(),
        }
    }
}
