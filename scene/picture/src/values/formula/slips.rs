//! Explains what is wrong in a formula: signs of other languages, a missing operand, a value that does not exist.

use super::functions::FUNCTIONS;

/// Message where an operand should begin.
pub(super) fn no_operand(text: &str, at: usize) -> String {
    let (before, rest) = text.split_at(at);
    let last = before.trim_end().chars().next_back();
    let message = match (rest.trim_start().chars().next(), last) {
        (None, None) => "is empty: write a formula, such as 2 * r",
        (None, Some('%')) => "ends after %, which is the remainder of a division: write 50% as 0.5",
        (None, Some(_)) => "ends too early: write a number, a name or a parenthesis here",
        (Some('*'), Some('*')) => "** is no operator: write ^ for a power",
        (Some('/'), Some('/')) => "// begins no comment in a formula: remove it",
        (Some('='), None) => "begins with =: leave it out",
        (Some('='), Some('=')) => "=== is no operator: use == to compare",
        (Some('!'), _) => "! is no operator: write if(c, 0, 1) for not c",
        (Some(',' | ')'), Some(',' | '(')) => "an argument is missing before this: write one, or remove the comma",
        (Some('[' | ']' | '{' | '}'), _) => "only parentheses group: use ( and )",
        (Some('\'' | '"' | '“' | '’'), _) => "a formula has no texts: write a number or a name",
        (Some('π'), _) => "names have the letters a to z: write pi",
        (Some(other), _) if other.is_alphabetic() => "names have the letters a to z, digits and _: use such a name",
        (Some('#'), _) => "a formula is of numbers, not of colors: write a number",
        _ => "a number, a name or a parenthesis is expected here: write one",
    };
    message.to_owned()
}

/// Message where an operator should be, after an operand.
pub(super) fn no_operator(text: &str, at: usize, is_in_parentheses: bool) -> String {
    let (before, rest) = text.split_at(at);
    let word: String = rest.chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '_').collect();
    let before_this = before.trim_end();
    let begin = before_this.rfind(|c: char| !c.is_ascii_alphanumeric() && c != '_').map_or(0, |end| end + 1);
    let operand = &before_this[begin..];
    let is_number = operand.starts_with(|c: char| c.is_ascii_digit());
    let message = match rest.chars().next() {
        Some(')') if !is_in_parentheses => "closes a parenthesis that was not opened: remove it",
        Some('=') => "= is no operator: use == to compare; numbers get their names in the scene's numbers",
        Some('!') => "! is no operator: use != to compare",
        Some('&') => "& is no operator: write a * b for a and b",
        Some('|') => "| is no operator: write max(a, b) for a or b",
        Some('?' | ':') => "is no operator: write if(c, a, b) for a choice",
        Some('×' | '·' | '∙') => "is no operator: write * to multiply",
        Some('÷') => "is no operator: write / to divide",
        Some('–' | '−' | '—') => "is no minus sign of a formula: write -",
        Some('²' | '³') => "is no operator: write ^ for a power",
        Some(';') => "a formula has no semicolon: remove it",
        Some('[' | ']' | '{' | '}') => "only parentheses group: use ( and )",
        Some(',') if !is_in_parentheses => "a comma is only for the arguments of a function: use . in numbers",
        Some('.') if is_number => "is a second point in a number: remove it",
        Some('.') => "a name has no points: write the last part of it alone",
        _ if word == "and" => "and is no operator: write a * b for a and b",
        _ if word == "or" => "or is no operator: write max(a, b) for a or b",
        Some(_) if FUNCTIONS.iter().any(|function| function.name == operand) => {
            return format!("{operand} needs parentheses: write {operand}(…)");
        }
        Some('a'..='z' | 'A'..='Z') if is_number && before_this == before => {
            "an operator is missing before this: write * to multiply, and numbers without units"
        }
        Some(other) if other.is_alphanumeric() || "(_".contains(other) => {
            "an operator is missing before this: write * to multiply"
        }
        Some(_) if is_in_parentheses => "an operator or ) is expected here: write one",
        Some(other) => return format!("{other:?} is no operator: use + - * / % ^ < <= > >= == !="),
        None => "ends too early: add )",
    };
    message.to_owned()
}

/// The name here of a function or a value that other languages call so.
pub(super) fn synonym(name: &str) -> Option<&'static str> {
    Some(match name.to_ascii_lowercase().as_str() {
        "lerp" | "linear" => "mix",
        "log" => "ln",
        "power" | "square" | "sqr" => "pow",
        "arcsin" => "asin",
        "arccos" => "acos",
        "arctan" => "atan",
        "rand" | "hash" => "random",
        "length" | "distance" => "hypot",
        "saturate" | "limit" => "clamp",
        "trunc" | "int" => "floor",
        "frac" => "fract",
        "iif" | "select" | "where" => "if",
        "time" | "seconds" => "t",
        "frame_count" => "frames",
        "index" => "i",
        "count" => "n",
        _ => return None,
    })
}

/// Fix of an operation that has no finite value for these numbers.
pub(super) fn cure(name: &str, numbers: &[f32]) -> &'static str {
    match (name, numbers) {
        ("/" | "%" | "mod", [.., 0.0]) => "divide by a number that is not 0",
        ("sqrt", _) => "use a number that is not below 0",
        ("ln", _) => "use a number above 0",
        ("asin" | "acos", _) => "use a number from -1 to 1",
        ("^" | "pow", [base, _]) if *base < 0.0 => "use a base that is not below 0, or a whole exponent",
        ("^" | "pow", [0.0, _]) => "use a base that is not 0",
        ("smoothstep", _) => "use two different edges",
        _ => "use smaller numbers: they go up to 3.4e38",
    }
}
