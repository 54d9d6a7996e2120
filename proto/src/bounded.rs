//! Numbers and names from outside, checked where they are parsed: one out of range is rejected with its place and its range.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

/// Measured speed of a worker, in camera rays per second.
///
/// Slower speeds than [`RaysPerSecond::MIN`] are raised to it, because a scene may be that slow; a negative speed,
/// or one above [`RaysPerSecond::MAX`], is an error.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct RaysPerSecond(f64);

impl RaysPerSecond {
    /// Least speed, in camera rays per second.
    pub const MIN: f64 = 1.0;
    /// Maximum speed, in camera rays per second: a hundred thousand times that of a fast GPU.
    pub const MAX: f64 = 1e15;

    /// A speed; `None` if it is negative, not a number, or above the maximum.
    pub fn new(rays_per_second: f64) -> Option<Self> {
        (0.0..=Self::MAX).contains(&rays_per_second).then(|| Self(rays_per_second.max(Self::MIN)))
    }

    /// The speed, from [`RaysPerSecond::MIN`] to [`RaysPerSecond::MAX`].
    pub fn get(self) -> f64 {
        self.0
    }
}

impl Serialize for RaysPerSecond {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for RaysPerSecond {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = f64::deserialize(deserializer)?;
        Self::new(value).ok_or_else(|| {
            D::Error::custom(format!("{value:?} is not a speed: use 0 to {:e} rays per second", Self::MAX))
        })
    }
}

/// Parses an integer of at most `MAX`.
pub(crate) fn at_most<'de, const MAX: u64, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
    let value = u64::deserialize(deserializer)?;
    if value > MAX {
        return Err(D::Error::custom(format!("{value} is too large: the maximum is {MAX}")));
    }
    Ok(value)
}

/// Parses a label of at most 200 characters.
pub(crate) fn label<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    const MAX_CHARACTERS: usize = 200;
    let label = String::deserialize(deserializer)?;
    let count = label.chars().count();
    if count > MAX_CHARACTERS {
        return Err(D::Error::custom(format!(
            "a name of {count} characters is too long: use at most {MAX_CHARACTERS}"
        )));
    }
    Ok(label)
}

/// Parses a device: `cpu`, or `cuda:N` with a number below 256. Each device is a label of metrics, so that there are few.
pub(crate) fn device<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let device = String::deserialize(deserializer)?;
    let is_gpu = device
        .strip_prefix("cuda:")
        .is_some_and(|number| number.parse::<u8>().is_ok_and(|parsed| parsed.to_string() == number));
    if is_gpu || device == "cpu" {
        Ok(device)
    } else {
        Err(D::Error::custom("a device is `cpu` or `cuda:0` to `cuda:255`"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_devices_and_workers_have_bounds() {
        let parse = |name: &str, device: &str| {
            let text = serde_json::json!({ "name": name, "device": device, "picture_version": 1, "max_nodes": null, "process": 1 });
            serde_json::from_value::<crate::worker_protocol::RegisterRequest>(text)
                .map(drop)
                .map_err(|error| error.to_string())
        };
        for device in ["cpu", "cuda:0", "cuda:255"] {
            assert_eq!(parse("a", device), Ok(()));
        }
        for device in ["", "cpu ", "cuda", "cuda:", "cuda:256", "cuda:00", "cuda:+1", "gpu"] {
            assert!(parse("a", device).is_err_and(|message| message.contains("`cuda:0` to `cuda:255`")), "{device}");
        }
        assert_eq!(parse(&"é".repeat(200), "cpu"), Ok(()));
        assert!(parse(&"é".repeat(201), "cpu").is_err_and(|message| message.contains("at most 200")));
    }

    #[test]
    fn a_speed_has_bounds() {
        let parse = |text: &str| serde_json::from_str::<RaysPerSecond>(text).ok().map(RaysPerSecond::get);
        assert_eq!(parse("1e-300"), Some(1.0));
        assert_eq!(parse("0"), Some(1.0));
        assert_eq!(parse("2.5e6"), Some(2.5e6));
        assert_eq!(parse("1e15"), Some(1e15));
        for wrong in ["-1", "-1e-300", "1.1e15", "1e308", "1e400", "18446744073709551616000", "null", "\"1\""] {
            assert_eq!(parse(wrong), None, "{wrong}");
        }
    }
}
