//! `sdfarm price`: time and cost of a job before it is rendered, where the time goes, and what would save most.

mod picture;

use std::io::Write;

use anyhow::Context;
use clap::Args;
use proto::Client;
use proto::preview_helper::PricePlan;
use proto::price::{Cost, DEFAULT_CURRENCY, Price, PriceSample, Rates, parse_currency, parse_price};
use proto::rounding;

use super::check::size::{CORES_OF_AN_H200, count, duration};
use crate::arguments::AuthArguments;
use crate::error::UsageError;
use crate::job_file::JobFile;
use crate::output_file::OutputFile;
use crate::overrides::OverrideArguments;
use crate::terminal::{escape_line, print_line, print_note};

/// Time for each measurement on this machine, where no other caller waits for it, in milliseconds.
const SAMPLE_MS: u64 = 2000;
const MAP_MS: u64 = 1500;
const SAVINGS_MS: u64 = 6000;

/// Arguments of `price`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job file; - for standard input.
    job: String,
    #[command(flatten)]
    overrides: OverrideArguments,
    /// Address of a farm whose workers set the price [default: this machine's cores].
    #[arg(long, value_name = "URL", env = "SDFARM_SERVER")]
    server: Option<String>,
    #[command(flatten)]
    auth: AuthArguments,
    #[command(flatten)]
    rates: RateArguments,
    /// File for a map of the time, a PNG; - for standard output.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT")]
    output: Option<String>,
    /// Print the price as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Prices that an operator sets.
#[derive(Clone, Debug, Args)]
pub(crate) struct RateArguments {
    /// Price of an hour of one CPU core, in the currency.
    #[arg(long, value_name = "PRICE", env = "SDFARM_PRICE_PER_CORE_HOUR", value_parser = parse_price)]
    price_per_core_hour: Option<f64>,
    /// Price of an hour of one GPU, in the currency.
    #[arg(long, value_name = "PRICE", env = "SDFARM_PRICE_PER_GPU_HOUR", value_parser = parse_price)]
    price_per_gpu_hour: Option<f64>,
    /// Currency of the prices.
    #[arg(long, value_name = "NAME", env = "SDFARM_CURRENCY", default_value = DEFAULT_CURRENCY, value_parser = parse_currency)]
    currency: String,
}

impl RateArguments {
    /// The prices.
    pub(crate) fn rates(&self) -> Rates {
        let Self { price_per_core_hour, price_per_gpu_hour, currency } = self.clone();
        Rates { core_hour: price_per_core_hour, gpu_hour: price_per_gpu_hour, currency }
    }
}

/// Prints the price.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let file = arguments.overrides.apply(JobFile::read(&arguments.job)?)?;
    let job = file.parse()?;
    let has_map = arguments.output.is_some() || arguments.json;
    let price = if let Some(server) = &arguments.server {
        let client = Client::with_auth(server, arguments.auth.auth()?)?;
        client.price(file.text.clone(), has_map).await.map_err(|error| file.invalid(error))?
    } else {
        // The job is valid, so its text is UTF-8.
        let text = String::from_utf8(file.text).context("a job file is UTF-8")?;
        let job = job.clone();
        let plan = PricePlan { sample_ms: SAMPLE_MS, map_ms: if has_map { MAP_MS } else { 0 }, savings_ms: SAVINGS_MS };
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let measured = tokio::task::spawn_blocking(move || helper::price(&text, &job, threads, plan));
        let measured = measured.await.context("the measurement was interrupted")??;
        of_this_machine(measured, threads, &arguments.rates.rates())
    };
    if let (Some(path), Some(map)) = (&arguments.output, &price.map) {
        let mut output = OutputFile::create(path)?;
        output.file().write_all(&picture::draw(&job, map)?).with_context(|| format!("could not write {path}"))?;
        output.commit()?;
    }
    let is_to_standard_output = arguments.output.as_deref() == Some("-");
    let lines = if arguments.json { vec![serde_json::to_string_pretty(&price)?] } else { lines(&file.name, &price) };
    for line in lines {
        if is_to_standard_output {
            print_note(&line);
        } else {
            print_line(&line)?;
        }
    }
    match (&arguments.output, &price.map) {
        (Some(_), None) => {
            Err(UsageError("the farm made no map: its release is older than this one".to_owned()).into())
        }
        _ => Ok(()),
    }
}

/// Price on the cores of this machine; with a price for GPUs alone, that of an H200.
fn of_this_machine(sample: PriceSample, threads: usize, rates: &Rates) -> Price {
    let PriceSample { cost: measured, core_seconds, map, savings } = sample;
    let seconds = core_seconds / threads.max(1) as f64;
    let (low, high) = measured.range(seconds);
    let cost = match rates {
        Rates { core_hour: None, gpu_hour: Some(_), .. } => rates.cost(0.0, core_seconds / CORES_OF_AN_H200),
        _ => rates.cost(core_seconds, 0.0),
    };
    Price {
        seconds: Some(rounding::seconds(seconds)),
        seconds_low: Some(rounding::seconds(low)),
        seconds_high: Some(rounding::seconds(high)),
        core_seconds: rounding::seconds(core_seconds),
        relative_error: rounding::fraction(measured.relative_error),
        cost,
        sample_rays: measured.rays,
        map,
        savings,
    }
}

/// The price in words.
fn lines(name: &str, price: &Price) -> Vec<String> {
    let Price { seconds, seconds_low, seconds_high, core_seconds, relative_error, cost, sample_rays, savings, .. } =
        price;
    let when = match (seconds, seconds_low, seconds_high) {
        (Some(seconds), Some(low), Some(high)) => {
            format!("about {}, from {} to {}", duration(*seconds), duration(*low), duration(*high))
        }
        _ => "unknown, because the farm has no worker".to_owned(),
    };
    let mut lines = vec![
        format!("{name}:"),
        format!("  time: {when}"),
        format!(
            "  work: {} of one core ± {:.0} %, estimated from {}",
            duration(*core_seconds),
            100.0 * relative_error,
            count(*sample_rays, "ray")
        ),
    ];
    if let Some(Cost { amount, currency }) = cost {
        lines.push(format!("  cost: {amount} {}", escape_line(currency)));
    }
    if savings.is_empty() {
        lines.push("  no number of the job would save more than a few percent".to_owned());
    } else {
        lines.push("  what would save most:".to_owned());
    }
    for saving in savings {
        let message = escape_line(&saving.message);
        lines.push(format!("    {message} ({} of one core)", duration(saving.saves_seconds)));
    }
    lines
}
