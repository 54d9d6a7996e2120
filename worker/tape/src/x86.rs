//! A tape as machine code of x86-64, for packets of 32 or 8 lanes.

mod arithmetic;
mod bounds;
mod emit;
mod fold;
mod isa;
mod make;
mod operands;
mod program;

use std::io;

use iced_x86::{BlockEncoder, BlockEncoderOptions, InstructionBlock};

use crate::tape::{Allocation, Linear, LinearTape, Step, allocate};
use emit::{Assembly, Emitter, FrameLayout};
use program::{Entry, MachineCode};

pub(crate) use isa::{AVX2, AVX512, Isa};
pub(crate) use program::{Frame, Program, Uniforms};

/// A function of the tape, with the places of its variables.
type Allocated<'a> = Option<(&'a Linear, Allocation)>;

/// Compiles a tape for a vector extension. Fails if this CPU does not have it, or where executable memory is refused.
pub(crate) fn compile(tape: &LinearTape, isa: &'static Isa) -> io::Result<Program> {
    if !isa.is_available() {
        return Err(io::Error::other("this CPU does not have the instructions"));
    }
    let machine = assemble(tape, isa);
    #[expect(unsafe_code, reason = "makes machine code callable")]
    // SAFETY: the instructions are available. The emitter reaches memory through the addresses of the signature only:
    // the parts of the layouts, the uniforms of the tape, its own constants, and the flag.
    unsafe {
        Program::new(machine, isa)
    }
}

fn assemble(tape: &LinearTape, isa: &'static Isa) -> MachineCode {
    let functions: Vec<Allocated<'_>> = tape
        .functions
        .iter()
        .map(|linear| linear.as_ref().map(|linear| (linear, allocate(linear, isa.registers_of(tape.has_table)))))
        .collect();
    let layouts = layouts(&functions, isa);
    let mut assembly = Assembly {
        functions: vec![None; functions.len()],
        uniforms: tape.uniforms,
        has_table: tape.has_table,
        ..Assembly::default()
    };
    for (index, function) in functions.iter().enumerate() {
        if let Some((linear, allocation)) = function {
            let is_entry = tape.entries.iter().any(|&(_, entry)| entry == index);
            Emitter::new(&mut assembly, isa, linear, allocation, &layouts, index).function(is_entry);
        }
    }
    // Until it is encoded, the address of an instruction is its number.
    for (index, instruction) in assembly.instructions.iter_mut().enumerate() {
        instruction.set_ip(index as u64 + 1);
    }
    let frame_bytes = layouts.iter().map(|layout| layout.end as usize).max().unwrap_or(0);
    let sizes = bounds::Sizes {
        frame: frame_bytes as u64,
        uniforms: program::uniform_bytes(isa, tape.uniforms, tape.has_table) as u64,
        constants: isa.input_bytes(assembly.constants.words.len()) as u64,
        packet: isa.packet_bytes().into(),
        row: 4 * functions.iter().flatten().flat_map(|(linear, _)| &linear.steps).map(row_words).max().unwrap_or(0),
    };
    debug_assert_eq!(bounds::violation(&assembly.instructions, sizes), None, "code stays in its memory");
    let block = InstructionBlock::new(&assembly.instructions, 0);
    let options = BlockEncoderOptions::RETURN_NEW_INSTRUCTION_OFFSETS;
    let encoded = BlockEncoder::encode(64, block, options).expect("every instruction can be encoded");
    let entry = |&(name, index): &(&'static str, usize)| {
        let (linear, _) = functions[index].as_ref()?;
        let offset = encoded.new_instruction_offsets[assembly.functions[index]?] as usize;
        let (arguments, results) = (linear.arguments.len(), linear.results.len());
        Some((name, Entry { offset, arguments, results }))
    };
    let entries = tape.entries.iter().filter_map(entry).collect();
    MachineCode {
        entries,
        constants: assembly.constants.words,
        frame_bytes,
        uniforms: tape.uniforms,
        has_table: tape.has_table,
        code: encoded.code_buffer,
    }
}

fn row_words(step: &Step) -> u64 {
    if let Step::Fold(fold) = step { fold.row_words.into() } else { 0 }
}

/// Parts of the functions in the frame: a callee's begins after all its callers', which come later in the
/// tape.
fn layouts(functions: &[Allocated<'_>], isa: &Isa) -> Vec<FrameLayout> {
    let mut starts = vec![0_u32; functions.len()];
    let mut layouts = vec![FrameLayout::default(); functions.len()];
    for (index, function) in functions.iter().enumerate().rev() {
        let Some((linear, allocation)) = function else { continue };
        // Functions of lists have been given the places of their arguments and results by their fold.
        let places = layouts[index].list_function;
        let layout = FrameLayout::new(starts[index], places, linear, allocation.slots, isa.packet_bytes());
        for step in &linear.steps {
            match step {
                Step::Call { callee, .. } => starts[*callee] = starts[*callee].max(layout.end),
                Step::Fold(fold) => {
                    let start = fold.functions().map(|function| starts[function]).fold(layout.end, u32::max);
                    let leaves = fold.leaves.iter().map(|leaf| (leaf, fold.leaf_layout()));
                    for (&function, places) in leaves.chain(fold.joins.iter().map(|join| (join, fold.join_layout()))) {
                        starts[function] = start;
                        layouts[function].list_function = Some(places);
                    }
                }
                _ => {}
            }
        }
        layouts[index] = layout;
    }
    layouts
}
