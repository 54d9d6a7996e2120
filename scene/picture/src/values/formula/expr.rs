//! A formula whose names have been replaced.

use std::sync::Arc;

use super::functions::{FUNCTIONS, Function, find};
use super::grammar::Syntax;
use super::program::Step;
use super::{FormulaError, MAX_FORMULA_STEPS, NAMES, Names, slips};
use crate::values::track::Track;

/// A formula whose names have been replaced. What does not depend on time is a number.
#[derive(Debug)]
pub enum Expr {
    /// A number.
    Number(f32),
    /// Seconds from frame 0.
    Seconds,
    /// Number of the frame.
    Frame,
    /// A number over time.
    Track(Arc<Track>),
    /// A function or an operator and its operands, some of them of time; and the number of operations.
    Call(&'static Function, Vec<Arc<Expr>>, u32),
}

impl Expr {
    /// Its number, if it does not depend on time.
    pub fn constant(&self) -> Option<f32> {
        match self {
            Self::Number(number) => Some(*number),
            Self::Seconds | Self::Frame | Self::Track(_) | Self::Call(..) => None,
        }
    }

    fn steps(&self) -> u32 {
        match self {
            Self::Call(_, _, steps) => *steps,
            Self::Number(_) | Self::Seconds | Self::Frame | Self::Track(_) => 1,
        }
    }

    /// The steps of a [`Formula`](super::Formula) with the same value at all times.
    pub fn to_steps(&self) -> Vec<Step> {
        let mut steps = Vec::new();
        self.push_steps(&mut steps);
        steps
    }

    fn push_steps(&self, steps: &mut Vec<Step>) {
        let step = match self {
            Self::Number(number) => Step::Number(*number),
            Self::Seconds => Step::Seconds,
            Self::Frame => Step::Frame,
            Self::Track(track) => Step::Track(Arc::clone(track)),
            Self::Call(function, operands, _) => {
                for operand in operands {
                    operand.push_steps(steps);
                }
                Step::Call(function, operands.len())
            }
        };
        steps.push(step);
    }
}

/// Replaces the names of a formula.
pub fn resolve(syntax: &Syntax, names: &mut impl Names) -> Result<Arc<Expr>, FormulaError> {
    match syntax {
        Syntax::Number(number, _) => Ok(Arc::new(Expr::Number(*number))),
        Syntax::Name(name, at) => match name.as_str() {
            "t" => Ok(Arc::new(Expr::Seconds)),
            "frame" => Ok(Arc::new(Expr::Frame)),
            "pi" => Ok(Arc::new(Expr::Number(std::f32::consts::PI))),
            _ => names.get(name).ok_or_else(|| unknown(name, *at, names)),
        },
        Syntax::Call(name, arguments, _) if name == "if" && arguments.len() == 3 => branch(arguments, names),
        Syntax::Call(name, arguments, at) => {
            let operands = arguments.iter().map(|argument| resolve(argument, names));
            let operands = operands.collect::<Result<Vec<_>, _>>()?;
            call(name, operands, *at)
        }
    }
}

/// A formula without a finite value: 1 / 0, which is found where it is evaluated.
fn no_value() -> Arc<Expr> {
    let operands = [1.0, 0.0].map(|number| Arc::new(Expr::Number(number)));
    Arc::new(Expr::Call(find("/").expect("an operator"), operands.to_vec(), 3))
}

/// The value of `if(condition, then, otherwise)`. The branch that is not taken, or sometimes not taken, needs no finite value.
fn branch(arguments: &[Syntax], names: &mut impl Names) -> Result<Arc<Expr>, FormulaError> {
    let condition = resolve(&arguments[0], names)?;
    let taken = condition.constant().map(|number| number != 0.0);
    let mut value = |argument: &Syntax, is_then: bool| match resolve(argument, names) {
        Err(error) if error.is_not_finite && taken != Some(is_then) => Ok(no_value()),
        resolved => resolved,
    };
    let (then, otherwise) = (value(&arguments[1], true)?, value(&arguments[2], false)?);
    match taken {
        Some(true) => Ok(then),
        Some(false) => Ok(otherwise),
        None => call("if", vec![condition, then, otherwise], 0),
    }
}

fn call(name: &str, operands: Vec<Arc<Expr>>, at: usize) -> Result<Arc<Expr>, FormulaError> {
    let Some(function) = find(name) else {
        return Err(unknown_function(name, at));
    };
    if !function.arity.contains(&operands.len()) {
        let Function { name, parameters, .. } = function;
        let message = format!("{name} has {} arguments: write {name}({parameters})", operands.len());
        return Err(FormulaError::new(at, message));
    }
    let numbers: Vec<f32> = operands.iter().filter_map(|operand| operand.constant()).collect();
    if numbers.len() == operands.len() {
        let value = (function.apply)(&numbers);
        if !value.is_finite() {
            let cure = slips::cure(name, &numbers);
            let operation = match numbers.as_slice() {
                [left, right] if function.parameters.is_empty() && *left < 0.0 => format!("({left}) {name} {right}"),
                [left, right] if function.parameters.is_empty() => format!("{left} {name} {right}"),
                numbers => {
                    let numbers: Vec<String> = numbers.iter().map(ToString::to_string).collect();
                    format!("{name}({})", numbers.join(", "))
                }
            };
            let message = format!("{operation} has no finite value: {cure}");
            return Err(FormulaError { is_not_finite: true, ..FormulaError::new(at, message) });
        }
        return Ok(Arc::new(Expr::Number(value)));
    }
    let steps = operands.iter().fold(1_u32, |steps, operand| steps.saturating_add(operand.steps()));
    if steps > MAX_FORMULA_STEPS {
        let message = format!("has more than {MAX_FORMULA_STEPS} operations, counting those of its names: simplify it");
        return Err(FormulaError::new(at, message));
    }
    Ok(Arc::new(Expr::Call(function, operands, steps)))
}

fn unknown(name: &str, at: usize, names: &impl Names) -> FormulaError {
    let message = if name == "i" || name == "n" {
        let cure = if names.is_copied() {
            "use it in \"at\", because all copies are of one shape"
        } else {
            "use it in the \"at\" of copies that have a count"
        };
        format!("{name} counts copies, and has no value here: {cure}")
    } else if FUNCTIONS.iter().any(|function| function.name == name) {
        format!("{name} is a function: write {name}(…)")
    } else {
        let known = names.all();
        let known = known.iter().map(String::as_str).chain(NAMES.map(|(name, _)| name));
        let meant = slips::synonym(name).filter(|meant| NAMES.iter().any(|(name, _)| name == meant));
        let meant = meant.or_else(|| nearest(name, known));
        let meant = meant.map(|meant| format!("; did you mean {meant}?")).unwrap_or_default();
        format!("{name} is not defined: add it to {}{meant}", names.place())
    };
    FormulaError::new(at, message)
}

fn unknown_function(name: &str, at: usize) -> FormulaError {
    let known = FUNCTIONS.iter().map(|function| function.name);
    let meant = slips::synonym(name).filter(|meant| known.clone().any(|known| known == *meant));
    let meant = meant.or_else(|| nearest(name, known.clone())).map(|meant| format!("did you mean {meant}?"));
    let all = || format!("choose one of {}", known.collect::<Vec<_>>().join(", "));
    FormulaError::new(at, format!("{name} is no function: {}", meant.unwrap_or_else(all)))
}

/// The name that was probably meant.
fn nearest<'n>(name: &str, known: impl Iterator<Item = &'n str>) -> Option<&'n str> {
    let known: Vec<&str> = known.take(2_000).collect();
    crate::names::nearest_name(name, &known, &[])
}
