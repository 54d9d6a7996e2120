//! Rounds numbers for display to the digits that were measured, so that JSON has `0.3333` and not
//! `0.33333333333333331`.
//!
//! Only for display: no decision depends on a rounded number.

/// Steps of one in a displayed fraction: four decimals.
const FRACTION_STEPS: f64 = 1e4;
/// Steps of a second in a displayed duration: milliseconds.
const STEPS_PER_SECOND: f64 = 1e3;
/// How far below a whole step the product of a rounded fraction may be, as a fraction of the step.
const SLACK: f64 = 1e-6;

/// A fraction from 0 to 1 with four decimals, rounded down: it is 1 only at the end.
pub fn fraction(value: f64) -> f64 {
    (value * FRACTION_STEPS + SLACK).floor() / FRACTION_STEPS
}

/// Seconds with three decimals.
pub fn seconds(value: f64) -> f64 {
    (value * STEPS_PER_SECOND).round() / STEPS_PER_SECOND
}

/// Rate a second without decimals; a rate below 1 is not rounded.
pub fn rate(value: f64) -> f64 {
    if value < 1.0 { value } else { value.round() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shown_numbers_have_few_digits() {
        for (value, shown) in [(1.0 / 3.0, "0.3333"), (0.99999, "0.9999"), (1.0, "1"), (0.0, "0"), (0.1, "0.1")] {
            assert_eq!(fraction(value).to_string(), shown);
        }
        for (value, shown) in [(2.0 / 3.0, "0.667"), (12.3456, "12.346"), (7.0, "7"), (1e9 / 3.0, "333333333.333")] {
            assert_eq!(seconds(value).to_string(), shown);
        }
        assert_eq!((rate(1_234_567.89), rate(0.25)), (1_234_568.0, 0.25));
    }

    #[test]
    fn rounding_twice_changes_nothing() {
        for step in 0..=10_000 {
            let value = f64::from(step) / 1e4;
            assert_eq!(fraction(value), value);
            assert_eq!(seconds(seconds(value)), seconds(value));
        }
    }
}
