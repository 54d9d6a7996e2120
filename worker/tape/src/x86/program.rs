//! A compiled tape and its memory: the unsafe call of its machine code.

#![expect(unsafe_code, reason = "runs machine code")]

#[cfg(test)]
mod guarded;
mod memory;

use std::io;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use math::real::{Table, Words};
use memmap2::{Mmap, MmapMut};

use super::isa::Isa;
use memory::Memory;

/// Words of a [`Packet`].
const WORDS: usize = 16;

/// Memory of a vector, aligned for every extension.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Packet([f32; WORDS]);

/// Signature of an entry: frame, uniforms, constants, cancel flag; arguments, results, bytes of their rows, packets in a
/// row.
type Function = unsafe extern "sysv64" fn(
    *mut Packet,
    *const Packet,
    *const Packet,
    *const bool,
    *const f32,
    *mut f32,
    usize,
    usize,
);

/// A compiled tape.
#[derive(Debug)]
pub(crate) struct Program {
    isa: &'static Isa,
    code: Mmap,
    constants: Memory,
    frame_packets: usize,
    entries: Vec<(&'static str, Entry)>,
    uniforms: usize,
    has_table: bool,
}

/// Function that can be run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    /// Of its code, in bytes.
    pub(super) offset: usize,
    pub(super) arguments: usize,
    pub(super) results: usize,
}

/// Machine code, and the sizes of the memory that it was emitted for.
#[derive(Debug)]
pub(super) struct MachineCode {
    pub(super) code: Vec<u8>,
    pub(super) constants: Vec<u32>,
    pub(super) frame_bytes: usize,
    pub(super) entries: Vec<(&'static str, Entry)>,
    pub(super) uniforms: usize,
    pub(super) has_table: bool,
}

/// Values of the uniforms, as a program reads them, and the table.
#[derive(Debug)]
pub(crate) struct Uniforms {
    numbers: Memory,
    /// The numbers end with its address, and the address of the maker of its words.
    table: Option<Table>,
}

impl Uniforms {
    /// The table.
    pub(crate) fn table(&self) -> Option<&Table> {
        self.table.as_ref()
    }
}

/// Memory of a thread that runs a program.
#[derive(Debug)]
pub(crate) struct Frame(Memory);

impl Program {
    /// Maps machine code: pages are written, then made executable, never both. Fails where executable memory is
    /// refused.
    ///
    /// # Safety
    /// This CPU has the instructions. Each entry begins at its offset, has the signature of [`Function`], and touches
    /// only its frame of `frame_bytes`, the uniforms, the constants, the flag, the rows of its arguments and results, and
    /// the words of the table up to the last index that the uniforms give.
    pub(super) unsafe fn new(machine: MachineCode, isa: &'static Isa) -> io::Result<Self> {
        let mut pages = MmapMut::map_anon(machine.code.len())?;
        pages.copy_from_slice(&machine.code);
        Ok(Self {
            isa,
            code: pages.make_exec()?,
            constants: packets(copied(&machine.constants, isa).into_iter()),
            frame_packets: machine.frame_bytes.div_ceil(size_of::<Packet>()).max(1),
            entries: machine.entries,
            uniforms: machine.uniforms,
            has_table: machine.has_table,
        })
    }

    /// Lanes of a packet.
    pub(crate) fn lanes(&self) -> usize {
        self.isa.lanes
    }

    /// Size of the machine code.
    pub(crate) fn code_bytes(&self) -> usize {
        self.code.len()
    }

    /// Memory to run it in.
    pub(crate) fn frame(&self) -> Frame {
        Frame(Memory::zeroed(self.frame_packets))
    }

    /// Values of the tape's uniforms, as bits, and its table. The tape is verified: its uniforms give the index of
    /// the table's last word.
    ///
    /// # Panics
    /// If their number is not the tape's, or only one of tape and program has a table.
    pub(crate) fn uniforms(&self, values: &[u32], table: Option<Table>) -> Uniforms {
        assert_eq!(values.len(), self.uniforms, "uniforms of the tape");
        assert_eq!(table.is_some(), self.has_table, "table of the tape");
        let mut words = copied(values, self.isa);
        if let Some(table) = &table {
            words.resize(self.isa.table_address_at(self.uniforms) / size_of::<u32>(), 0);
            let maker: extern "sysv64" fn(*const Words, u32) -> u32 = made;
            table.as_ptr().expose_provenance();
            for address in [table.as_ptr().addr(), maker as usize, Arc::as_ptr(table).addr()] {
                words.extend([address as u32, (address as u64 >> 32) as u32]);
            }
            Arc::as_ptr(table).expose_provenance();
            words.resize(uniform_bytes(self.isa, self.uniforms, true) / size_of::<u32>(), 0);
        }
        Uniforms { numbers: packets(words.into_iter()), table }
    }

    /// Evaluates an entry. Arguments and results are rows of one length, a multiple of the lanes. Once `cancel` is set,
    /// it returns early, with meaningless results.
    ///
    /// # Panics
    /// If there is no such entry, or the arguments, results, frame or uniforms do not match this program.
    pub(crate) fn run(
        &self,
        entry: &str,
        frame: &mut Frame,
        uniforms: &Uniforms,
        cancel: &AtomicBool,
        arguments: &[f32],
        results: &mut [f32],
    ) {
        let (_, entry) = *self.entries.iter().find(|(name, _)| *name == entry).expect("an entry of the tape");
        let length = results.len() / entry.results;
        assert!(length.is_multiple_of(self.isa.lanes), "whole packets");
        assert_eq!(arguments.len(), entry.arguments * length, "arguments of the entry");
        assert_eq!(results.len(), entry.results * length, "results of the entry");
        assert_eq!(frame.0.bytes(), self.frame_packets * size_of::<Packet>(), "frame of the program");
        let bytes = uniform_bytes(self.isa, self.uniforms, uniforms.table.is_some());
        assert_eq!(uniforms.numbers.bytes(), bytes, "uniforms of the program");
        assert_eq!(uniforms.table.is_some(), self.has_table, "table of the program");
        if length == 0 {
            return;
        }
        let address = self.code[entry.offset..].as_ptr();
        // SAFETY: `new` was promised that an entry with this signature begins there.
        let function = unsafe { std::mem::transmute::<*const u8, Function>(address) };
        // SAFETY: `new` was promised that it touches only this memory, whose sizes were asserted above.
        unsafe {
            function(
                frame.0.packets().as_mut_ptr(),
                uniforms.numbers.address(),
                self.constants.address(),
                cancel.as_ptr(),
                arguments.as_ptr(),
                results.as_mut_ptr(),
                length * size_of::<f32>(),
                length / self.isa.lanes,
            );
        }
    }
}

/// The word in place of a missing one; called by machine code. A panic is a failure of the table: no code above could
/// pass it on.
extern "sysv64" fn made(words: *const Words, missing: u32) -> u32 {
    // SAFETY: `uniforms` wrote the address of a table that it keeps.
    let words = unsafe { &*words };
    std::panic::catch_unwind(AssertUnwindSafe(|| words.make(missing))).unwrap_or_else(|_| {
        words.fail();
        missing
    })
}

/// Bytes of a program's uniforms, with the addresses of its table and of what makes its words: then whole packets, so that vectors that end with them
/// are aligned.
pub(super) fn uniform_bytes(isa: &Isa, uniforms: usize, has_table: bool) -> usize {
    if has_table {
        (isa.table_address_at(uniforms) + 3 * size_of::<u64>()).next_multiple_of(size_of::<Packet>())
    } else {
        isa.input_bytes(uniforms)
    }
}

/// Words as the code of an extension expects them.
fn copied(words: &[u32], isa: &Isa) -> Vec<u32> {
    words.iter().flat_map(|word| std::iter::repeat_n(*word, isa.copies())).collect()
}

/// Words as code reads them. At least one packet, so that there is an address.
fn packets(words: impl ExactSizeIterator<Item = u32>) -> Memory {
    let bytes = words.len() * size_of::<u32>();
    let mut memory = Memory::zeroed(bytes.div_ceil(size_of::<Packet>()).max(1));
    let places = memory.packets().iter_mut().flat_map(|packet| &mut packet.0);
    places.zip(words).for_each(|(to, from)| *to = f32::from_bits(from));
    memory.limited(bytes)
}
