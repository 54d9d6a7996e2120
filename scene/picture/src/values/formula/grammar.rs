//! The grammar of formulas: arithmetic, comparisons, names and calls, with the usual precedence.

use winnow::ascii::{digit0, digit1, multispace0};
use winnow::combinator::{Infix, Prefix};
use winnow::combinator::{alt, cut_err, delimited, dispatch, expression, fail, opt, peek, preceded, repeat};
use winnow::error::{ErrMode, ParserError};
use winnow::stream::{LocatingSlice, Location, Stream};
use winnow::token::{any, one_of, take_while};
use winnow::{ModalResult, Parser};

use super::{FormulaError, MAX_FORMULA_BYTES, MAX_FORMULA_DEPTH, slips};

/// A formula as written. Offsets are in bytes from its start.
#[derive(Clone, Debug, PartialEq)]
pub enum Syntax {
    /// A number, and its offset.
    Number(f32, usize),
    /// A name.
    Name(String, usize),
    /// A function or an operator by its name, its operands, and its offset.
    Call(String, Vec<Syntax>, usize),
}

type Text<'t> = LocatingSlice<&'t str>;
type Parsed<T> = ModalResult<T, FormulaError>;

/// Stands for the message of an error whose cause is sought once its place is known.
const NO_OPERAND: &str = "";
/// As above, where an operator should be.
const NO_OPERATOR: &str = "no operator";

impl<'t> ParserError<Text<'t>> for FormulaError {
    type Inner = Self;

    fn from_input(input: &Text<'t>) -> Self {
        Self::new(input.current_token_start(), NO_OPERAND)
    }

    fn into_inner(self) -> Result<Self, Self> {
        Ok(self)
    }
}

/// Whether formulas can refer to a number by this name.
pub fn is_name(text: &str) -> bool {
    let is_letter = |byte: u8| byte.is_ascii_alphabetic() || byte == b'_';
    text.bytes().next().is_some_and(is_letter) && text.bytes().all(|byte| is_letter(byte) || byte.is_ascii_digit())
}

/// Parses a formula.
pub fn parse(text: &str) -> Result<Syntax, FormulaError> {
    if text.len() > MAX_FORMULA_BYTES {
        let message = format!("has {} bytes: use at most {MAX_FORMULA_BYTES}, and names for its parts", text.len());
        return Err(FormulaError::new(0, message));
    }
    // Parentheses and signs are parsed by recursion.
    let mut depth = 0_usize;
    for (at, byte) in text.bytes().enumerate() {
        match byte {
            b'(' => depth += 1,
            b')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth > MAX_FORMULA_DEPTH {
            let message = format!("nests deeper than {MAX_FORMULA_DEPTH} parentheses: use names for its parts");
            return Err(FormulaError::new(at, message));
        }
    }
    let mut input = LocatingSlice::new(text);
    let formula = sum.parse_next(&mut input).map_err(|error| explained(text, error))?;
    let at = input.current_token_start();
    if at < text.len() { Err(FormulaError::new(at, slips::no_operator(text, at, false))) } else { Ok(formula) }
}

fn explained(text: &str, error: ErrMode<FormulaError>) -> FormulaError {
    let FormulaError { at, message, .. } = match error {
        ErrMode::Backtrack(error) | ErrMode::Cut(error) => error,
        ErrMode::Incomplete(_) => FormulaError::new(0, NO_OPERAND),
    };
    FormulaError::new(
        at,
        match message.as_str() {
            NO_OPERAND => slips::no_operand(text, at),
            NO_OPERATOR => slips::no_operator(text, at, true),
            _ => message,
        },
    )
}

/// An expression with operators: `^` binds strongest, then signs, then `* / %`, `+ -`, and comparisons.
fn sum(input: &mut Text<'_>) -> Parsed<Syntax> {
    // The functions of operators must not capture, so each has its own.
    macro_rules! infix {
        ($Side:ident, $power:literal, $symbol:literal) => {
            Infix::$Side($power, |_, left, right| Ok(call($symbol, vec![left, right])))
        };
    }
    let mut symbol = alt(("<=", ">=", "==", "!=", one_of(b"<>+-*/%^").take()));
    let infix = dispatch! { symbol;
        "<" => infix!(Left, 1, "<"),
        "<=" => infix!(Left, 1, "<="),
        ">" => infix!(Left, 1, ">"),
        ">=" => infix!(Left, 1, ">="),
        "==" => infix!(Left, 1, "=="),
        "!=" => infix!(Left, 1, "!="),
        "+" => infix!(Left, 3, "+"),
        "-" => infix!(Left, 3, "-"),
        "*" => infix!(Left, 5, "*"),
        "/" => infix!(Left, 5, "/"),
        "%" => infix!(Left, 5, "%"),
        "^" => infix!(Right, 9, "^"),
        _ => fail,
    };
    let prefix = dispatch! { one_of(['-', '+']);
        '-' => Prefix(7, |_: &mut Text<'_>, operand| Ok(call("negate", vec![operand]))),
        '+' => Prefix(7, |_: &mut Text<'_>, operand| Ok(operand)),
        _ => fail,
    };
    let tree = expression(operand).prefix(delimited(multispace0, prefix, multispace0));
    let tree = tree.infix(delimited(multispace0, infix, multispace0)).parse_next(input);
    let tree = tree?;
    multispace0.parse_next(input)?;
    Ok(tree)
}

/// An operator with its operands, where they begin.
fn call(symbol: &str, operands: Vec<Syntax>) -> Syntax {
    let at = operands.first().map_or(0, |first| match first {
        Syntax::Number(_, at) | Syntax::Name(_, at) | Syntax::Call(_, _, at) => *at,
    });
    Syntax::Call(symbol.to_owned(), operands, at)
}

fn operand(input: &mut Text<'_>) -> Parsed<Syntax> {
    multispace0.parse_next(input)?;
    match peek(opt(any)).parse_next(input)? {
        Some('(') => {
            let open = input.current_token_start();
            any.parse_next(input)?;
            let inside = cut_err(sum).parse_next(input)?;
            close(input, open)?;
            Ok(inside)
        }
        Some('0'..='9' | '.') => number(input),
        Some('a'..='z' | 'A'..='Z' | '_') => named(input),
        _ => Err(ErrMode::from_input(input)),
    }
}

fn close(input: &mut Text<'_>, open: usize) -> Parsed<()> {
    let at = input.current_token_start();
    match opt(any).parse_next(input)? {
        Some(')') => Ok(()),
        None => Err(ErrMode::Cut(FormulaError::new(open, "this parenthesis is not closed: add )"))),
        Some(_) => Err(ErrMode::Cut(FormulaError::new(at, NO_OPERATOR))),
    }
}

fn number(input: &mut Text<'_>) -> Parsed<Syntax> {
    let at = input.current_token_start();
    let mantissa = alt(((digit1, opt(('.', digit0))).take(), ('.', digit1).take()));
    let exponent = opt((alt(('e', 'E')), opt(alt(('+', '-'))), digit1));
    let text = (mantissa, exponent).take().parse_next(input)?;
    match text.parse::<f32>() {
        Ok(value) if value.is_finite() => Ok(Syntax::Number(value, at)),
        _ => Err(ErrMode::Cut(FormulaError::new(at, format!("{text} is too large: numbers go up to 3.4e38")))),
    }
}

/// A name, or a call of a function.
fn named(input: &mut Text<'_>) -> Parsed<Syntax> {
    let at = input.current_token_start();
    let name = take_while(1.., |c: char| c.is_ascii_alphanumeric() || c == '_').parse_next(input)?;
    let after = input.checkpoint();
    multispace0.parse_next(input)?;
    if !matches!(peek(opt(any)).parse_next(input)?, Some('(')) {
        input.reset(&after);
        return Ok(Syntax::Name(name.to_owned(), at));
    }
    let open = input.current_token_start();
    any.parse_next(input)?;
    multispace0.parse_next(input)?;
    if matches!(peek(opt(any)).parse_next(input)?, Some(')')) {
        any.parse_next(input)?;
        return Ok(Syntax::Call(name.to_owned(), Vec::new(), at));
    }
    let rest = preceded(',', cut_err(sum));
    let first = cut_err(sum).parse_next(input)?;
    let mut rest: Vec<Syntax> = repeat(0.., rest).parse_next(input)?;
    close(input, open)?;
    rest.insert(0, first);
    Ok(Syntax::Call(name.to_owned(), rest, at))
}
