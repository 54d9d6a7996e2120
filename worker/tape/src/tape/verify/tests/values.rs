//! Tapes that are broken in the definition of a value.

use super::*;
use crate::tape::Operation::{
    Add, Constant, FromBits, Less, Mul, Select, ShiftLeft, ShiftRight, Sqrt, ToBits, Uniform,
};

pub(super) const CASES: &[Case] = &[
    ("unknown operand", |t| instruction(t, Add).operands[0] = Some(NOWHERE), Fault::UnknownValue),
    ("unknown second operand", |t| instruction(t, Mul).operands[1] = Some(NOWHERE), Fault::UnknownValue),
    (
        "operand just past the last value",
        |t| {
            let end = ValueId(t.instructions.len() as u32);
            instruction(t, Sqrt).operands[0] = Some(end);
        },
        Fault::UnknownValue,
    ),
    ("first operand missing", |t| instruction(t, Add).operands[0] = None, Fault::OperandCount { takes: 2 }),
    ("hole between operands", |t| instruction(t, Select).operands[1] = None, Fault::OperandCount { takes: 3 }),
    ("operands moved by one", |t| instruction(t, Sqrt).operands.rotate_right(1), Fault::OperandCount { takes: 1 }),
    (
        "operand of a constant",
        |t| instruction(t, Constant(0)).operands[0] = Some(ValueId(0)),
        Fault::OperandCount { takes: 0 },
    ),
    (
        "operand of an argument",
        |t| instruction(t, Operation::Argument).operands[2] = Some(ValueId(0)),
        Fault::OperandCount { takes: 0 },
    ),
    (
        "constant of type Bool",
        |t| {
            add(t, ValueType::Bool, Constant(1), [None; 3]);
        },
        Fault::BoolInput,
    ),
    (
        "uniform of type Bool",
        |t| {
            add(t, ValueType::Bool, Uniform(0), [None; 3]);
        },
        Fault::BoolInput,
    ),
    (
        "uniform past the last",
        |t| {
            add(t, ValueType::F32, Uniform(2), [None; 3]);
        },
        Fault::UnknownUniform(2),
    ),
    (
        "uniform far past the last",
        |t| instruction(t, Uniform(0)).operation = Uniform(u32::MAX),
        Fault::UnknownUniform(0),
    ),
    ("no uniforms", |t| t.uniforms.clear(), Fault::UnknownUniform(0)),
    (
        "shift by 32",
        |t| {
            let by = word(t, 32);
            instruction(t, ShiftLeft).operands[1] = Some(by);
        },
        Fault::Shift,
    ),
    (
        "shift right by 32",
        |t| {
            let by = word(t, 32);
            instruction(t, ShiftRight).operands[1] = Some(by);
        },
        Fault::Shift,
    ),
    (
        "shift by the largest number",
        |t| {
            let by = word(t, u32::MAX);
            instruction(t, ShiftLeft).operands[1] = Some(by);
        },
        Fault::Shift,
    ),
    (
        "shift by a computed number",
        |t| {
            let by = find(t, ToBits);
            instruction(t, ShiftRight).operands[1] = Some(by);
        },
        Fault::Shift,
    ),
    (
        "shift by a uniform",
        |t| {
            let by = add(t, ValueType::U32, Uniform(0), [None; 3]);
            instruction(t, ShiftLeft).operands[1] = Some(by);
        },
        Fault::Shift,
    ),
    (
        "bits of a word",
        |t| {
            let bits = find(t, ToBits);
            instruction(t, ToBits).operands[0] = Some(bits);
        },
        SOME_TYPE,
    ),
    (
        "number of a number",
        |t| {
            let sum = find(t, Add);
            instruction(t, FromBits).operands[0] = Some(sum);
        },
        SOME_TYPE,
    ),
    (
        "choice by a number",
        |t| {
            let sum = find(t, Add);
            instruction(t, Select).operands[0] = Some(sum);
        },
        SOME_TYPE,
    ),
    (
        "choice of conditions",
        |t| {
            let less = find(t, Less);
            *instruction(t, Select) =
                Instruction { kind: ValueType::Bool, operation: Select, operands: [Some(less); 3] };
        },
        SOME_TYPE,
    ),
    ("sum defined as a product of words", |t| instruction(t, Add).operation = Operation::MulU32, SOME_TYPE),
    (
        "own operand",
        |t| {
            let own = find(t, Sqrt);
            instruction(t, Sqrt).operands[0] = Some(own);
        },
        Fault::NotVisible,
    ),
    (
        "operand defined later",
        |t| {
            let last = find(t, FromBits);
            instruction(t, Sqrt).operands[0] = Some(last);
        },
        Fault::NotVisible,
    ),
    (
        "value that no statement defines",
        |t| {
            let a = find(t, Operation::Argument);
            add(t, ValueType::F32, Operation::Neg, [Some(a), None, None]);
        },
        Fault::NeverDefined,
    ),
    (
        "variable that no statement defines",
        |t| {
            add(t, ValueType::F32, Operation::Variable, [None; 3]);
        },
        Fault::NeverDefined,
    ),
    (
        "argument of no function",
        |t| {
            add(t, ValueType::F32, Operation::Argument, [None; 3]);
        },
        Fault::NeverDefined,
    ),
    (
        "result of no call",
        |t| {
            add(t, ValueType::F32, Operation::CallResult, [None; 3]);
        },
        Fault::NeverDefined,
    ),
    ("too many uniforms", |t| t.uniforms.resize(MAX_VALUES + 1, 0), Fault::ManyValues(0)),
    ("too many values", |t| t.instructions.resize(MAX_VALUES + 1, t.instructions[0]), Fault::ManyValues(0)),
];
