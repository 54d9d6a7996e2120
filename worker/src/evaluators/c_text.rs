//! The C source of the same formulas: the host's compiler builds one program of it, which must give the reference's bits,
//! and NVRTC must compile it.

use tape::Tape;

use super::{ENTRY, Formula, arguments, operations, random_formulas};
use crate::c_program::{evaluate, source};
use crate::cuda::Compiler;
use crate::random_formula::Generator;
use crate::skip::skip;

/// Evaluations of each formula.
const COUNT: usize = 1280;

/// Kernel that evaluates every formula.
const KERNEL: &str = r#"
extern "C" __global__ void evaluate_all(const float* numbers, float* results) {
    for (int entry = 0; entry < ENTRIES; ++entry)
        results[entry] = evaluate(entry, numbers[0], numbers[1], numbers[2]);
}
"#;

fn tapes(formulas: &[Formula]) -> Vec<&Tape> {
    formulas.iter().map(|formula| &formula.tape).collect()
}

#[test]
fn c_text_compiled_by_the_host_gives_the_reference_bits() {
    let formulas: Vec<Formula> = operations().into_iter().chain(random_formulas()).collect();
    let arguments = arguments(&mut Generator(1), COUNT);
    let Some(results) = evaluate(&tapes(&formulas), ENTRY, &arguments) else { return };
    for (formula, results) in formulas.iter().zip(results) {
        for (lane, got) in results.into_iter().enumerate() {
            formula.assert_equal("C text", [0, 1, 2].map(|place| arguments[place * COUNT + lane]), got);
        }
    }
}

#[test]
fn c_text_is_compiled_by_nvrtc() {
    let compiler = match Compiler::find() {
        Ok(compiler) => compiler,
        Err(missing) => return skip("nvrtc", format_args!("no formula was compiled for a GPU: {missing}")),
    };
    let formulas: Vec<Formula> = operations().into_iter().chain(random_formulas().into_iter().take(60)).collect();
    let code = compiler.compile(&source(&tapes(&formulas), ENTRY, KERNEL), 90);
    let code = code.unwrap_or_else(|error| panic!("{error}"));
    assert!(code.starts_with(b"\x7fELF"), "machine code is an ELF file");
}
