//! Shortens numbers of a schema to the fewest digits that identify the same `f32`: `0.1`, not `0.10000000149011612`.
//!
//! It changes only how numbers are written, not the numbers of a job.

use serde_json::{Number, Value};

/// Shortens every number in a document.
pub(super) fn shorten(value: &mut Value) {
    match value {
        Value::Number(number) => {
            if let Some(short) = shortest(number) {
                *number = short;
            }
        }
        Value::Array(members) => members.iter_mut().for_each(shorten),
        Value::Object(members) => members.values_mut().for_each(shorten),
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

/// The shorter form of a number that was an `f32` before it was widened.
fn shortest(number: &Number) -> Option<Number> {
    let wide = number.as_f64().filter(|_| number.is_f64())?;
    let narrow = wide as f32;
    if f64::from(narrow) != wide {
        return None;
    }
    Number::from_f64(narrow.to_string().parse().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widened_numbers_get_their_short_form_and_others_stay() {
        let mut document = serde_json::json!({
            "default": [f64::from(0.1_f32), f64::from(0.8_f32), 0.5, 3, -1.0],
            "wide": 0.1,
            "nested": { "small": f64::from(1e-6_f32), "text": "0.1" },
        });
        shorten(&mut document);
        let want = r#"{"default":[0.1,0.8,0.5,3,-1.0],"nested":{"small":1e-6,"text":"0.1"},"wide":0.1}"#;
        assert_eq!(document.to_string(), want);
    }

    #[test]
    fn numbers_of_the_schema_have_no_excess_digits() {
        fn check(value: &Value) {
            match value {
                Value::Number(number) => {
                    let text = number.to_string();
                    let digits: String =
                        text.split('e').next().unwrap_or("").chars().filter(char::is_ascii_digit).collect();
                    assert!(number.is_u64() || digits.trim_matches('0').len() <= 9, "{number}");
                }
                Value::Array(members) => members.iter().for_each(check),
                Value::Object(members) => members.values().for_each(check),
                Value::Null | Value::Bool(_) | Value::String(_) => {}
            }
        }
        check(&super::super::schema());
    }
}
