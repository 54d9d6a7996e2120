//! A program of the C source of tapes, built for tests by the host's compiler.

use std::fmt::Write as _;
use std::io::Write as _;
use std::process::{Command, Stdio};

use crate::skip::skip;
use crate::tape::Tape;

/// Exact arithmetic for both compilers, and a kernel that is not used here.
const KERNEL: &str = include_str!("../../src/cuda/kernel.cu");

/// Evaluates every entry for the arguments on standard input.
const MAIN: &str = r"
#include <stdio.h>
static float numbers[3][COUNT], results[COUNT];
int main() {
    if (fread(numbers, sizeof numbers, 1, stdin) != 1) return 1;
    for (int entry = 0; entry < ENTRIES; ++entry) {
        for (int lane = 0; lane < COUNT; ++lane)
            results[lane] = evaluate(entry, numbers[0][lane], numbers[1][lane], numbers[2][lane]);
        if (fwrite(results, sizeof results, 1, stdout) != 1) return 1;
    }
    return 0;
}
";

/// Words of a tape's own table.
const WORD_AT: &str =
    "INLINE_FN unsigned word_at(unsigned index, unsigned last) { return words[index < last ? index : last]; }
INLINE_FN unsigned word_of_row(unsigned row, unsigned place) { return words[row + place]; }";

/// C source of the entry of this name of each tape, which has three arguments, for both compilers. The function
/// `evaluate` returns the first result of one of the `ENTRIES`, by its number; `main` follows it.
pub(crate) fn source(tapes: &[&Tape], entry: &str, main: &str) -> String {
    let (arithmetic, _) = KERNEL.split_once("// ---- the picture ----").expect("kernel.cu has a place for the picture");
    let mut text = format!("#define UNIFORM_COUNT 1\n{arithmetic}");
    text += "#ifdef __CUDACC_RTC__\n#define UNIFORM static __constant__\n#else\n#define UNIFORM static const\n#endif\n";
    let mut cases = String::new();
    for (index, tape) in tapes.iter().enumerate() {
        let code = tape.to_c().expect("the tape is valid").code;
        let uniforms: Vec<String> =
            tape.uniforms().iter().map(|&bits| format!("{:?}f", f32::from_bits(bits))).collect();
        let (count, uniforms) = (uniforms.len().max(1), uniforms.join(", "));
        let _ = writeln!(text, "namespace t{index} {{\nUNIFORM float uniforms[{count}] = {{{uniforms}}};");
        if let Some(table) = tape.table() {
            let words: Vec<String> = table.after(0).iter().map(|word| format!("{word}u")).collect();
            let _ = writeln!(text, "UNIFORM unsigned words[] = {{{}}};\n{WORD_AT}", words.join(", "));
        }
        let _ = writeln!(text, "{code}}}\n");
        let _ = writeln!(cases, "        case {index}: return t{index}::step_{entry}(a, b, c).f0;");
    }
    let _ = writeln!(text, "#define ENTRIES {}", tapes.len());
    let head = "NOINLINE_FN float evaluate(int entry, float a, float b, float c) {\n    switch (entry) {\n";
    text + head + &cases + "        default: return 0.0f;\n    }\n}\n" + main
}

/// Results of these entries for three rows of arguments, one row for each tape. Skips the test, and returns `None`, if
/// no compiler is installed.
pub(crate) fn evaluate(tapes: &[&Tape], entry: &str, arguments: &[f32]) -> Option<Vec<Vec<f32>>> {
    let count = arguments.len() / 3;
    let folder = tempfile::tempdir().expect("a scratch folder");
    let (text, program) = (folder.path().join("tapes.cpp"), folder.path().join("tapes"));
    let source = source(tapes, entry, &format!("#define COUNT {count}\n{MAIN}"));
    std::fs::write(&text, source).expect("a scratch folder can be written");
    let compiler = std::env::var("CXX").unwrap_or_else(|_| "c++".to_owned());
    let compiled =
        Command::new(&compiler).args(["-std=c++17", "-O1", "-ffp-contract=off", "-o"]).args([&program, &text]).output();
    let Ok(compiled) = compiled else {
        skip("c++", format_args!("no tape was compiled as C: {compiler} is not installed"));
        return None;
    };
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    let mut child =
        Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("the program starts");
    let input: Vec<u8> = arguments.iter().flat_map(|number| number.to_ne_bytes()).collect();
    child.stdin.take().expect("standard input is piped").write_all(&input).expect("the program reads");
    let output = child.wait_with_output().expect("the program ends");
    assert!(output.status.success());
    let numbers: Vec<f32> =
        output.stdout.chunks_exact(4).map(|bytes| f32::from_ne_bytes(bytes.try_into().expect("four bytes"))).collect();
    assert_eq!(numbers.len(), count * tapes.len());
    Some(numbers.chunks_exact(count).map(<[f32]>::to_vec).collect())
}
