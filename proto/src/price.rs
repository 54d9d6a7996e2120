//! Price of a job before it is rendered: its time and cost, where the time goes, and which numbers would save most.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::preview_helper::CostSample;

/// Response to `POST /v1/price`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Price {
    /// Seconds until the last picture is stored, if the farm's current workers rendered nothing else; null without
    /// workers.
    pub seconds: Option<f64>,
    /// Lower end of the range that `seconds` is in with a chance of 95 %.
    pub seconds_low: Option<f64>,
    /// Upper end of that range.
    pub seconds_high: Option<f64>,
    /// CPU time, in seconds of one core.
    pub core_seconds: f64,
    /// Error of `core_seconds` as a fraction of it: the true value is within it with a chance of 95 %.
    pub relative_error: f64,
    /// Cost of the job; null if the operator has set no price for the devices that would render it.
    pub cost: Option<Cost>,
    /// Camera rays of the sample that all this is based on.
    pub sample_rays: u64,
    /// Where the time of frame 0 goes; null if it was not asked for.
    pub map: Option<PriceMap>,
    /// The numbers of the job whose reduction would save most, at most three.
    pub savings: Vec<Saving>,
}

/// An amount of money.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Cost {
    /// The amount.
    pub amount: f64,
    /// Currency as the operator wrote it, `EUR` for example.
    pub currency: String,
}

/// Where the time of a frame goes: a grid of cells over the picture, row by row from the top.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PriceMap {
    /// Number of columns.
    pub columns: u32,
    /// Number of rows.
    pub rows: u32,
    /// CPU time of each cell, in seconds of one core.
    pub seconds: Vec<f64>,
    /// Mean number of march steps of a camera ray in each cell.
    pub steps: Vec<f64>,
}

/// A number of a job, and what a lower one would save.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Saving {
    /// JSON pointer of the number in the job.
    pub pointer: String,
    /// Its value; null for a member that is there and would be removed.
    pub from: Option<f64>,
    /// The lower value; null if the member would be removed.
    pub to: Option<f64>,
    /// CPU time that it saves, in seconds of one core.
    pub saves_seconds: f64,
    /// The same as a fraction of all CPU time.
    pub saves_share: f64,
    /// How much the picture changes: root of the mean square over the sample, in levels of 255; null if another size makes
    /// that incomparable.
    pub change_levels: Option<f64>,
    /// All of this in words.
    pub message: String,
}

/// Answer of the helper process: everything that depends on the job alone.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PriceSample {
    /// The measured costs.
    pub cost: CostSample,
    /// CPU time of the whole job, in seconds of one core.
    pub core_seconds: f64,
    /// Where the time goes.
    pub map: Option<PriceMap>,
    /// Numbers that would save most.
    pub savings: Vec<Saving>,
}

/// Prices that an operator sets.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rates {
    /// Of an hour of one core.
    pub core_hour: Option<f64>,
    /// Of an hour of one GPU.
    pub gpu_hour: Option<f64>,
    /// Currency of both.
    pub currency: String,
}

/// Default currency of prices.
pub const DEFAULT_CURRENCY: &str = "EUR";

impl Rates {
    /// Cost of this much time of cores and GPUs; `None` if a price is missing that it needs.
    pub fn cost(&self, core_seconds: f64, gpu_seconds: f64) -> Option<Cost> {
        let of = |seconds: f64, price: Option<f64>| {
            if seconds > 0.0 { price.map(|price| seconds / 3600.0 * price) } else { Some(0.0) }
        };
        let amount = of(core_seconds, self.core_hour)? + of(gpu_seconds, self.gpu_hour)?;
        // Two significant digits of what is estimated anyway.
        let amount = format!("{amount:.2e}").parse().unwrap_or(amount);
        Some(Cost { amount, currency: self.currency.clone() })
    }
}

/// Parses a price: a number from 0 that is not absurd.
pub fn parse_price(text: &str) -> Result<f64, String> {
    let price = text.parse().ok().filter(|price: &f64| (0.0..=1e9).contains(price));
    price.ok_or_else(|| "use a number from 0, such as 0.04".to_owned())
}

/// Parses a currency: a short name.
pub fn parse_currency(text: &str) -> Result<String, String> {
    let is_name = (1..=8).contains(&text.chars().count()) && !text.chars().any(|c| c.is_control() || c.is_whitespace());
    if is_name { Ok(text.to_owned()) } else { Err("use a short name, such as EUR".to_owned()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cost_needs_the_price_of_each_device_that_renders() {
        let rates = Rates { core_hour: Some(0.04), gpu_hour: None, currency: "EUR".to_owned() };
        assert_eq!(rates.cost(36_000.0, 0.0).map(|cost| cost.amount), Some(0.4));
        assert_eq!(rates.cost(36_000.0, 1.0), None);
        let both = Rates { gpu_hour: Some(2.5), ..rates };
        assert_eq!(both.cost(36_000.0, 3600.0).map(|cost| cost.amount), Some(2.9));
        assert!(parse_price("-1").is_err() && parse_price("NaN").is_err() && parse_price("0.04").is_ok());
        assert!(parse_currency("").is_err() && parse_currency("E U").is_err() && parse_currency("€").is_ok());
    }
}
