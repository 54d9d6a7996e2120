//! WGSL source of a tape, for approximate pictures in a browser: WGSL promises no fused operation, no exact quotient and no
//! exact root. Uniforms and the words of the table are in storage buffers (`wgsl/picture.wgsl`), so that a changed number
//! compiles nothing.

use math::real::{INDEX_BITS, LIST_PLACE};

use super::source::{FunctionParts, Language, SourceText};
use super::verify::InvalidTape;
use super::{Instruction, Operation, Tape, ValueType};

impl Tape {
    /// Generates WGSL source. Fails if the tape is invalid.
    pub fn to_wgsl(&self) -> Result<SourceText, InvalidTape> {
        self.print(&Wgsl)
    }

    /// Uniforms by their bits, in which the greatest numbers stand in for infinity.
    pub fn finite_uniforms(&self) -> Vec<u32> {
        let mut uniforms = self.uniforms.clone();
        for Instruction { kind, operation, .. } in &self.instructions {
            if let (ValueType::F32, Operation::Uniform(place)) = (kind, operation) {
                let bits = &mut uniforms[*place as usize];
                *bits = finite(f32::from_bits(*bits)).to_bits();
            }
        }
        uniforms
    }
}

struct Wgsl;

impl Language for Wgsl {
    fn type_name(&self, kind: ValueType) -> &'static str {
        match kind {
            ValueType::F32 => "f32",
            ValueType::Bool => "bool",
            ValueType::U32 => "u32",
        }
    }

    fn constant(&self, _: ValueType, name: &str, value: &str) -> String {
        format!("let {name} = {value};")
    }

    fn result(&self, _: &str, name: &str, call: &str) -> String {
        format!("let {name} = {call};")
    }

    fn variable(&self, kind: ValueType, name: &str, value: &str) -> String {
        format!("var {name}: {} = {value};", self.type_name(kind))
    }

    fn counted_loop(&self, limit: u32) -> String {
        format!("for (var i = 0u; i < {limit}u; i++) {{")
    }

    fn list_loop(&self, list: &str, words: u32) -> String {
        format!("for (var at: u32 = {list};; at += {words}u) {{")
    }

    fn break_if(&self, condition: &str) -> String {
        format!("if ({condition}) {{ break; }}")
    }

    /// Browsers' compilers copy functions to their calls, so that the four points of a normal would be four
    /// copies of the scene.
    fn groups_calls(&self) -> bool {
        true
    }

    fn list(&self, kind: &str, name: &str, values: &[String]) -> String {
        format!("var {name} = array<{kind}, {}>({});", values.len(), values.join(", "))
    }

    fn empty_list(&self, kind: &str, name: &str, length: usize) -> String {
        format!("var {name}: array<{kind}, {length}>;")
    }

    fn loop_over(&self, length: usize) -> String {
        format!("for (var k = 0u; k < {length}u; k++) {{")
    }

    fn function(&self, function: &FunctionParts<'_>) -> String {
        let FunctionParts { name, is_called: _, arguments, body, results } = function;
        let arguments: Vec<String> =
            arguments.iter().map(|(kind, name)| format!("{name}: {}", self.type_name(*kind))).collect();
        let fields: Vec<String> =
            (0..).zip(results).map(|(place, (kind, _))| format!("f{place}: {}", self.type_name(*kind))).collect();
        let values: Vec<&str> = results.iter().map(|(_, value)| value.as_str()).collect();
        format!(
            "struct {name}_result {{ {} }}\nfn step_{name}({}) -> {name}_result {{\n{body}    return {name}_result({});\n}}\n\n",
            fields.join(", "),
            arguments.join(", "),
            values.join(", "),
        )
    }

    fn known(&self, kind: ValueType, operation: Operation) -> String {
        let word = match operation {
            Operation::Constant(bits) => match kind {
                ValueType::F32 => return number(f32::from_bits(bits)),
                ValueType::Bool => return (bits != 0).to_string(),
                ValueType::U32 => return format!("{bits}u"),
            },
            Operation::Uniform(place) => format!("numbers[{place}]"),
            Operation::Row(place) => format!("words[row + {place}u]"),
            _ => unreachable!("it has a name"),
        };
        match kind {
            ValueType::F32 => format!("bitcast<f32>({word})"),
            ValueType::Bool => format!("({word} != 0u)"),
            ValueType::U32 => word,
        }
    }

    fn operation(&self, operation: Operation, [a, b, c]: [&str; 3]) -> String {
        match operation {
            Operation::Add | Operation::AddU32 => format!("{a} + {b}"),
            Operation::Sub => format!("{a} - {b}"),
            Operation::Mul | Operation::MulU32 => format!("{a} * {b}"),
            Operation::Div => format!("{a} / {b}"),
            Operation::Fma => format!("fma({a}, {b}, {c})"),
            Operation::Min => format!("min({a}, {b})"),
            Operation::Max => format!("max({a}, {b})"),
            Operation::Neg => format!("-{a}"),
            Operation::Abs => format!("abs({a})"),
            Operation::Floor => format!("floor({a})"),
            Operation::Sqrt => format!("root_of({a})"),
            Operation::Less => format!("{a} < {b}"),
            Operation::And => format!("{a} && {b}"),
            Operation::Or => format!("{a} || {b}"),
            Operation::Not => format!("!{a}"),
            Operation::Select => format!("select({c}, {b}, {a})"),
            Operation::ToBits => format!("bitcast<u32>({a})"),
            Operation::FromBits => format!("bitcast<f32>({a})"),
            Operation::Xor => format!("{a} ^ {b}"),
            Operation::AndU32 => format!("{a} & {b}"),
            Operation::OrU32 => format!("{a} | {b}"),
            Operation::ShiftLeft => format!("{a} << {b}"),
            Operation::ShiftRight => format!("{a} >> {b}"),
            Operation::Word => format!("word_at({a}, {b})"),
            // A cell that was not divided has the list of the cell around it, which gives the same value.
            Operation::Made => {
                let index = format!("({a} & {}u)", (1_u32 << INDEX_BITS) - 1);
                format!("word_at({index} + {LIST_PLACE}u, {b}) | {}u", 1_u32 << INDEX_BITS)
            }
            Operation::Constant(_)
            | Operation::Uniform(_)
            | Operation::Row(_)
            | Operation::Argument
            | Operation::CallResult
            | Operation::Variable => unreachable!("not defined by a statement"),
        }
    }
}

/// The number, or the greatest one in place of infinity: WGSL has no literal for it, and a browser may take no number to be
/// infinite.
fn finite(value: f32) -> f32 {
    value.clamp(f32::MIN, f32::MAX)
}

/// WGSL literal of a number.
fn number(value: f32) -> String {
    let value = finite(value);
    // The shortest digits of the greatest number are above it, which a browser rejects.
    if value == f32::MAX {
        return "0x1.fffffep+127f".to_owned();
    }
    if value == f32::MIN {
        return "(-0x1.fffffep+127f)".to_owned();
    }
    // The shortest digits that parse to this number.
    if value.is_sign_negative() { format!("({value:?}f)") } else { format!("{value:?}f") }
}
