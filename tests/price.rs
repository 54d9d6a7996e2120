//! Prices of jobs, on a farm and without one.

use serde_json::Value;

use crate::support::{Farm, root, run, succeed, text};

fn scene(name: &str) -> String {
    root().join("scenes").join(name).to_str().expect("a plain path").to_owned()
}

#[test]
fn farm_prices_a_job_with_its_map_and_its_savings() {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu", "--price-per-core-hour", "36", "--currency", "CHF"]);
    farm.ready(1);
    let job = std::fs::read(scene("mandelbulb.json")).expect("shipped");
    let answer = farm.send("POST", "/v1/price?map=true", &[], job.clone());
    assert_eq!(answer.status, 200, "{}\n{}", answer.text(), farm.log());
    let price = answer.json();
    let number = |name: &str| price[name].as_f64().unwrap_or_else(|| panic!("{name} in {price}"));
    assert!(number("seconds_low") < number("seconds") && number("seconds") < number("seconds_high"), "{price}");
    let amount = price["cost"]["amount"].as_f64().expect("a price is set");
    assert!((amount / number("core_seconds") * 100.0 - 1.0).abs() < 0.02, "an hour of a core is 36: {price}");
    assert_eq!(price["cost"]["currency"], "CHF");
    let map = &price["map"];
    let cells = map["columns"].as_u64().expect("a number") * map["rows"].as_u64().expect("a number");
    let list = |name: &str| -> Vec<f64> {
        map[name].as_array().expect("a list").iter().map(|value| value.as_f64().expect("a number")).collect()
    };
    assert_eq!((list("seconds").len() as u64, list("steps").len() as u64), (cells, cells));
    let sum: f64 = list("seconds").iter().sum();
    assert!((sum / number("core_seconds") - 1.0).abs() < 0.05, "{sum} in {price}");
    // The fractal in the middle takes more steps than the sky in the corner; the seconds of a few rays are noisy.
    let middle = (cells / 2 + map["columns"].as_u64().expect("a number") / 2) as usize;
    assert!(list("steps")[middle] > 2.0 * list("steps")[0], "{map}");
    let savings = price["savings"].as_array().expect("a list");
    assert!((1..=3).contains(&savings.len()), "{price}");
    assert!(savings.iter().any(|saving| saving["pointer"] == "/image/samples"), "{price}");

    let quick = farm.send("POST", "/v1/price?savings=false", &[], job).json();
    assert!(quick["map"].is_null() && quick["savings"] == serde_json::json!([]), "{quick}");
    let wrong = farm.send("POST", "/v1/price", &[], b"{}".to_vec());
    assert_eq!(wrong.status, 422, "{}", wrong.text());
    let printed = succeed(&["price", &scene("csg.json"), "--server", &farm.address]);
    assert!(printed.contains("time: about") && printed.contains("CHF"), "{printed}");
}

#[test]
fn price_needs_no_farm() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("map.png");
    let name = file.to_str().expect("a plain name");
    let printed = succeed(&[
        "price",
        &scene("menger.json"),
        "--scale",
        "25%",
        "--json",
        "-o",
        name,
        "--price-per-gpu-hour",
        "2.5",
    ]);
    let price: Value = serde_json::from_str(&printed).expect("JSON");
    assert!(price["cost"]["amount"].as_f64().is_some_and(|amount| amount > 0.0), "{price}");
    assert_eq!(price["cost"]["currency"], "EUR");
    assert!(std::fs::read(&file).expect("drawn").starts_with(b"\x89PNG"));
    let wrong = run(&["price", &scene("menger.json"), "--price-per-core-hour", "-1"]);
    assert_eq!(wrong.status.code(), Some(2), "{}", text(&wrong.stderr));
}
