//! C source of a tape: the same source for CUDA's compiler and for the host's; only the preamble differs
//! (`cuda/kernel.cu`). Operations with a defined rounding are functions in the preamble. Straight source for packets
//! (`tests/lab/src/straight.cpp`) has another preamble, and a function that selects, because C++ has no operator for that to
//! define.

use math::real::{INDEX_BITS, LENGTH_PLACE, STAND_IN};

use super::source::{FunctionParts, Language, SourceText};
use super::verify::InvalidTape;
use super::{Operation, Tape, ValueType};

/// Whether a condition is one or a packet of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Conditions {
    Single,
    Packets,
}

impl Tape {
    /// Generates C source. Fails if the tape is invalid.
    pub fn to_c(&self) -> Result<SourceText, InvalidTape> {
        self.print(&Conditions::Single)
    }

    /// Generates C source in which `float`, `bool` and `unsigned` may be packets, if the tape has no loops and
    /// branches.
    pub fn to_packet_c(&self) -> Result<SourceText, InvalidTape> {
        self.print(&Conditions::Packets)
    }
}

impl Language for Conditions {
    fn type_name(&self, kind: ValueType) -> &'static str {
        match kind {
            ValueType::F32 => "float",
            ValueType::Bool => "bool",
            ValueType::U32 => "unsigned",
        }
    }

    fn constant(&self, kind: ValueType, name: &str, value: &str) -> String {
        format!("const {} {name} = {value};", self.type_name(kind))
    }

    fn result(&self, function: &str, name: &str, call: &str) -> String {
        format!("const {function}_result {name} = {call};")
    }

    fn variable(&self, kind: ValueType, name: &str, value: &str) -> String {
        format!("{} {name} = {value};", self.type_name(kind))
    }

    fn counted_loop(&self, limit: u32) -> String {
        format!("for (unsigned i = 0; i < {limit}u; ++i) {{")
    }

    fn list_loop(&self, list: &str, words: u32) -> String {
        format!("ONE_COPY for (unsigned at = {list};; at += {words}u) {{")
    }

    fn break_if(&self, condition: &str) -> String {
        format!("if ({condition}) break;")
    }

    fn groups_calls(&self) -> bool {
        false
    }

    fn list(&self, kind: &str, name: &str, values: &[String]) -> String {
        format!("const {kind} {name}[] = {{ {} }};", values.join(", "))
    }

    fn empty_list(&self, kind: &str, name: &str, length: usize) -> String {
        format!("{kind} {name}[{length}];")
    }

    fn loop_over(&self, length: usize) -> String {
        format!("for (unsigned k = 0; k < {length}u; ++k) {{")
    }

    fn function(&self, function: &FunctionParts<'_>) -> String {
        let FunctionParts { name, is_called, arguments, body, results } = function;
        let arguments: Vec<String> =
            arguments.iter().map(|(kind, name)| format!("{} {name}", self.type_name(*kind))).collect();
        let fields: Vec<String> =
            (0..).zip(results).map(|(place, (kind, _))| format!("{} f{place};", self.type_name(*kind))).collect();
        let values: Vec<&str> = results.iter().map(|(_, value)| value.as_str()).collect();
        let linkage = if *is_called { "NOINLINE_FN" } else { "INLINE_FN" };
        format!(
            "struct {name}_result {{ {} }};\n{linkage} {name}_result step_{name}({}) {{\n{body}    return {{ {} }};\n}}\n\n",
            fields.join(" "),
            arguments.join(", "),
            values.join(", "),
        )
    }

    fn known(&self, kind: ValueType, operation: Operation) -> String {
        match (operation, kind) {
            (Operation::Constant(bits), ValueType::F32) => number(f32::from_bits(bits)),
            (Operation::Constant(bits), ValueType::Bool | ValueType::U32) => format!("{bits}u"),
            (Operation::Uniform(place), ValueType::F32 | ValueType::Bool) => format!("uniforms[{place}]"),
            (Operation::Uniform(place), ValueType::U32) => format!("bits_of(uniforms[{place}])"),
            (Operation::Row(place), ValueType::F32 | ValueType::Bool) => {
                format!("float_from_bits(word_of_row(row, {place}u))")
            }
            (Operation::Row(place), ValueType::U32) => format!("word_of_row(row, {place}u)"),
            _ => unreachable!("it has a name"),
        }
    }

    fn operation(&self, operation: Operation, [a, b, c]: [&str; 3]) -> String {
        match operation {
            Operation::Add | Operation::AddU32 => format!("{a} + {b}"),
            Operation::Sub => format!("{a} - {b}"),
            Operation::Mul | Operation::MulU32 => format!("{a} * {b}"),
            Operation::Div => format!("div_rn({a}, {b})"),
            Operation::Fma => format!("fma_rn({a}, {b}, {c})"),
            Operation::Min => format!("min_f({a}, {b})"),
            Operation::Max => format!("max_f({a}, {b})"),
            Operation::Neg => format!("-{a}"),
            Operation::Abs => format!("abs_f({a})"),
            Operation::Floor => format!("floor_f({a})"),
            Operation::Sqrt => format!("sqrt_rn({a})"),
            Operation::Less => format!("{a} < {b}"),
            Operation::And => format!("{a} && {b}"),
            Operation::Or => format!("{a} || {b}"),
            Operation::Not => format!("!{a}"),
            Operation::Select => match self {
                Self::Single => format!("{a} ? {b} : {c}"),
                Self::Packets => format!("select_f({a}, {b}, {c})"),
            },
            Operation::ToBits => format!("bits_of({a})"),
            Operation::FromBits => format!("float_from_bits({a})"),
            Operation::Xor => format!("{a} ^ {b}"),
            Operation::AndU32 => format!("{a} & {b}"),
            Operation::OrU32 => format!("{a} | {b}"),
            Operation::ShiftLeft => format!("{a} << {b}"),
            Operation::ShiftRight => format!("{a} >> {b}"),
            Operation::Word => format!("word_at({a}, {b})"),
            Operation::Made => {
                format!("made_word({a}, {}u, {LENGTH_PLACE}u, {STAND_IN}u)", (1_u32 << INDEX_BITS) - 1)
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

/// C literal of a number, exact to the bit.
fn number(value: f32) -> String {
    if !value.is_finite() {
        return format!("float_from_bits({:#010x}u)", value.to_bits());
    }
    // The shortest digits that parse to this number.
    if value.is_sign_negative() { format!("({value:?}f)") } else { format!("{value:?}f") }
}
