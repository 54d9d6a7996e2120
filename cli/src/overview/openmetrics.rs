//! Parser of metrics in the `OpenMetrics` format: names, labels, values. Unreadable lines are skipped.

/// One sample: a metric's name, labels and value.
#[derive(Clone, Debug, PartialEq)]
struct MetricSample {
    name: String,
    labels: Vec<(String, String)>,
    value: f64,
}

/// All samples of a response.
#[derive(Clone, Debug, Default)]
pub(super) struct Metrics(Vec<MetricSample>);

impl Metrics {
    /// Parses the samples.
    pub(super) fn read(text: &str) -> Self {
        Self(text.lines().filter(|line| !line.starts_with('#')).filter_map(sample).collect())
    }

    /// Sum of a metric's values that have these labels.
    pub(super) fn sum(&self, name: &str, labels: &[(&str, &str)]) -> f64 {
        let has = |sample: &MetricSample| labels.iter().all(|(key, value)| sample.get(key) == Some(value));
        self.0
            .iter()
            .filter(|sample| sample.name == name && has(sample))
            .map(|sample| sample.value)
            .fold(0.0, |sum, value| sum + value)
    }

    /// Sum of a metric's values whose label matches.
    pub(super) fn sum_where(&self, name: &str, label: &str, matches: &dyn Fn(&str) -> bool) -> f64 {
        let has = |sample: &MetricSample| sample.get(label).is_some_and(matches);
        self.0
            .iter()
            .filter(|sample| sample.name == name && has(sample))
            .map(|sample| sample.value)
            .fold(0.0, |sum, value| sum + value)
    }

    /// Value of a metric's label.
    pub(super) fn label(&self, name: &str, label: &str) -> Option<&str> {
        self.0.iter().find(|sample| sample.name == name)?.get(label)
    }
}

impl MetricSample {
    fn get(&self, label: &str) -> Option<&str> {
        self.labels.iter().find(|(key, _)| key == label).map(|(_, value)| value.as_str())
    }
}

fn sample(line: &str) -> Option<MetricSample> {
    let (name, rest) = line.split_at(line.find(['{', ' '])?);
    let (labels, value) = match rest.strip_prefix('{') {
        Some(rest) => {
            let (labels, value) = rest.rsplit_once("} ")?;
            (read_labels(labels)?, value)
        }
        None => (Vec::new(), rest.trim_start()),
    };
    Some(MetricSample { name: name.to_owned(), labels, value: value.split(' ').next()?.parse().ok()? })
}

fn read_labels(mut text: &str) -> Option<Vec<(String, String)>> {
    let mut labels = Vec::new();
    while !text.is_empty() {
        let (key, rest) = text.split_once("=\"")?;
        let mut value = String::new();
        let mut letters = rest.char_indices();
        let end = loop {
            match letters.next()? {
                (end, '"') => break end,
                (_, '\\') => value.push(match letters.next()?.1 {
                    'n' => '\n',
                    other => other,
                }),
                (_, letter) => value.push(letter),
            }
        };
        labels.push((key.to_owned(), value));
        text = rest[end + 1..].trim_start_matches(',');
    }
    Some(labels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_parsed_with_their_labels() {
        let samples = Metrics::read(
            "# TYPE a counter\na_total 3\na_total{x=\"1\",y=\"a \\\"b\\\" } c\"} 4.5 1700000000\nb inf\nodd\nodd{x=} 1\n# EOF",
        );
        assert_eq!(samples.sum("a_total", &[]), 7.5);
        assert_eq!(samples.sum("a_total", &[("x", "1")]), 4.5);
        assert_eq!(samples.label("c", "y"), None);
        assert_eq!(samples.sum_where("a_total", "y", &|value| value == "a \"b\" } c"), 4.5);
        assert!(samples.sum("b", &[]).is_infinite());
        assert_eq!(samples.sum("odd", &[]), 0.0);
    }
}
