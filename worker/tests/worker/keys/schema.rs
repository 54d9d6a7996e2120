//! Walks a job together with its schema: finds the schema's points that each value covers, and other values
//! that would be valid there.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Map, Value, json};

/// Maximum number of values of one type that are stored as replacements for others.
const KEPT: usize = 3;
/// Keywords with lists of alternatives.
const ALTERNATIVES: [&str; 2] = ["anyOf", "oneOf"];

/// Schema of job files.
pub(crate) struct Schema(Value);

/// Value in a job.
pub(crate) struct Position<'a> {
    /// Its JSON pointer in the job.
    pub(crate) pointer: String,
    /// Points of the schema that the value covers: properties, alternatives, values of enumerations.
    pub(crate) path: Vec<String>,
    /// Schemas on the path to the value, outermost first.
    schemas: Vec<String>,
    pub(crate) value: &'a Value,
}

impl Position<'_> {
    /// Stores the value under each schema on its path.
    pub(crate) fn pool_into(&self, pools: &mut BTreeMap<String, Vec<Value>>) {
        for schema in &self.schemas {
            let pool = pools.entry(schema.clone()).or_default();
            if pool.len() < KEPT && !pool.contains(self.value) {
                pool.push(self.value.clone());
            }
        }
    }
}

impl Schema {
    pub(crate) fn new(schema: Value) -> Self {
        Self(schema)
    }

    fn at(&self, pointer: &str) -> &Value {
        self.0.pointer(&pointer[1..]).unwrap_or_else(|| panic!("no {pointer} in the schema"))
    }

    fn object(&self, pointer: &str) -> &Map<String, Value> {
        self.at(pointer).as_object().unwrap_or_else(|| panic!("{pointer} is not a schema"))
    }

    /// A schema and those that it refers to, one after another.
    fn referred(&self, pointer: &str) -> Vec<String> {
        let mut all = vec![pointer.to_owned()];
        while let Some(next) = self.object(&all[all.len() - 1]).get("$ref") {
            all.push(next.as_str().unwrap().to_owned());
        }
        all
    }

    /// Every point of the schema: properties, alternatives and values of enumerations, by their pointers.
    pub(crate) fn points(&self) -> BTreeSet<String> {
        let mut points = BTreeSet::new();
        self.reach("#", &mut points, &mut BTreeSet::new());
        points
    }

    fn reach(&self, pointer: &str, points: &mut BTreeSet<String>, seen: &mut BTreeSet<String>) {
        if !seen.insert(pointer.to_owned()) {
            return;
        }
        for (keyword, inside) in self.object(pointer) {
            match (keyword.as_str(), inside) {
                ("$ref", Value::String(next)) => self.reach(next, points, seen),
                ("properties", Value::Object(properties)) => {
                    for key in properties.keys() {
                        let point = format!("{pointer}/properties/{key}");
                        self.reach(&point, points, seen);
                        points.insert(point);
                    }
                }
                ("anyOf" | "oneOf" | "prefixItems", Value::Array(entries)) => {
                    for index in 0..entries.len() {
                        let point = format!("{pointer}/{keyword}/{index}");
                        self.reach(&point, points, seen);
                        if keyword != "prefixItems" {
                            points.insert(point);
                        }
                    }
                }
                ("items" | "additionalProperties", Value::Object(_)) => {
                    self.reach(&format!("{pointer}/{keyword}"), points, seen);
                }
                ("enum", Value::Array(values)) => points.extend(values.iter().map(|v| format!("{pointer}={v}"))),
                ("type", Value::Array(types)) => points.extend(types.iter().map(|t| format!("{pointer}={t}"))),
                ("allOf" | "if" | "dependentSchemas" | "patternProperties", _) => {
                    panic!("{pointer} has {keyword}, which this walk does not support")
                }
                _ => {}
            }
        }
    }

    /// Visits every value of a job.
    pub(crate) fn walk<'a>(&self, job: &'a Value, visit: &mut dyn FnMut(&Position<'a>)) {
        self.walk_at("#", job, String::new(), &[], visit);
    }

    fn walk_at<'a>(
        &self,
        schema: &str,
        value: &'a Value,
        pointer: String,
        path: &[String],
        visit: &mut dyn FnMut(&Position<'a>),
    ) {
        let mut position = Position { pointer, path: path.to_vec(), schemas: Vec::new(), value };
        self.meet(schema, &mut position);
        visit(&position);
        for schema in &position.schemas {
            let keywords = self.object(schema);
            let mut inside = |schema: String, step: &str, value: &'a Value, point: Option<String>| {
                let path: Vec<String> = position.path.iter().cloned().chain(point).collect();
                self.walk_at(&schema, value, format!("{}/{step}", position.pointer), &path, visit);
            };
            if let (Some(properties), Some(values)) = (keywords.get("properties"), value.as_object()) {
                for (key, value) in values.iter().filter(|(key, _)| properties.get(key).is_some()) {
                    let point = format!("{schema}/properties/{key}");
                    inside(point.clone(), key, value, Some(point));
                }
            }
            if let (Some(Value::Object(_)), Some(values)) = (keywords.get("additionalProperties"), value.as_object()) {
                for (key, value) in values {
                    inside(format!("{schema}/additionalProperties"), key, value, None);
                }
            }
            for (index, value) in value.as_array().into_iter().flatten().enumerate() {
                let first = keywords.get("prefixItems").and_then(|items| items.get(index)).is_some();
                if first {
                    inside(format!("{schema}/prefixItems/{index}"), &index.to_string(), value, None);
                } else if keywords.contains_key("items") {
                    inside(format!("{schema}/items"), &index.to_string(), value, None);
                }
            }
        }
    }

    /// Follows references, and the alternatives that match the value.
    fn meet(&self, schema: &str, position: &mut Position<'_>) {
        for schema in self.referred(schema) {
            let keywords = self.object(&schema);
            if keywords.get("enum").is_some() {
                position.path.push(format!("{schema}={}", position.value));
            }
            if let Some(Value::Array(_)) = keywords.get("type") {
                position.path.push(format!("{schema}={}", json!(type_of(position.value))));
            }
            position.schemas.push(schema.clone());
            for point in self.alternatives(&schema) {
                if self.is_met(&point, position.value) {
                    position.path.push(point.clone());
                    position.path.extend(self.referred(&point).iter().find_map(|schema| self.only_property(schema)));
                    self.meet(&point, position);
                    break;
                }
            }
        }
    }

    /// Property that a schema requires as its only one: the name of its variant.
    fn only_property(&self, schema: &str) -> Option<String> {
        let keywords = self.object(schema);
        let (properties, required) = (keywords.get("properties")?.as_object()?, keywords.get("required")?.as_array()?);
        let key = properties.keys().next().filter(|_| properties.len() == 1 && required.len() == 1)?;
        Some(format!("{schema}/properties/{key}"))
    }

    fn alternatives(&self, schema: &str) -> Vec<String> {
        let keywords = self.object(schema);
        let listed = ALTERNATIVES.into_iter().filter_map(|keyword| Some((keyword, keywords.get(keyword)?.as_array()?)));
        listed
            .flat_map(|(keyword, all)| (0..all.len()).map(move |index| format!("{schema}/{keyword}/{index}")))
            .collect()
    }

    /// Whether a value matches a schema: its type, its members, its alternatives.
    fn is_met(&self, schema: &str, value: &Value) -> bool {
        self.referred(schema).iter().all(|schema| {
            let keywords = self.object(schema);
            let is_type = |name: &Value| {
                let own = type_of(value);
                name == own || (name == "number" && own == "integer")
            };
            let type_is_met = keywords.get("type").is_none_or(|types| match types {
                Value::Array(types) => types.iter().any(is_type),
                one => is_type(one),
            });
            let alternatives = self.alternatives(schema);
            let has_keys = value.as_object().is_none_or(|values| {
                let known = |key| keywords.get("properties").is_some_and(|properties| properties.get(key).is_some());
                let is_closed = keywords.get("additionalProperties") == Some(&json!(false));
                let required = keywords.get("required").and_then(Value::as_array).into_iter().flatten();
                required.filter_map(Value::as_str).all(|key| values.contains_key(key))
                    && (!is_closed || values.keys().all(|key| known(key.as_str())))
            });
            type_is_met
                && has_keys
                && keywords.get("const").is_none_or(|only| only == value)
                && keywords.get("enum").and_then(Value::as_array).is_none_or(|all| all.contains(value))
                && (alternatives.is_empty() || alternatives.iter().any(|schema| self.is_met(schema, value)))
        })
    }

    /// Values that could replace this one, each with the points of the schema that it would cover.
    pub(crate) fn candidates(
        &self,
        position: &Position<'_>,
        pools: &BTreeMap<String, Vec<Value>>,
    ) -> Vec<(Vec<String>, Value)> {
        let mut candidates: Vec<(Vec<String>, Value)> =
            others(position.value).into_iter().map(|value| (Vec::new(), value)).collect();
        for schema in &position.schemas {
            let keywords = self.object(schema);
            for value in keywords.get("enum").and_then(Value::as_array).into_iter().flatten() {
                candidates.push((vec![format!("{schema}={value}")], value.clone()));
            }
            if keywords.get("type").and_then(Value::as_array).is_some_and(|types| types.contains(&json!("null"))) {
                candidates.push((vec![format!("{schema}=\"null\"")], Value::Null));
            }
            if let Some(least) = keywords.get("minimum") {
                candidates.push((Vec::new(), least.clone()));
            }
            for point in self.alternatives(schema) {
                let referred = self.referred(&point);
                let last = self.object(&referred[referred.len() - 1]);
                let only =
                    last.get("const").cloned().or((last.get("type") == Some(&json!("null"))).then_some(Value::Null));
                let is = |name: &str| referred.iter().any(|schema| *schema == format!("#/$defs/{name}"));
                let track = is("Track").then(|| tracks(position.value));
                let track = track.or_else(|| is("Formula").then(|| formulas(position.value)));
                let track =
                    track.or_else(|| (is("PointTrack") || is("ColorTrack")).then(|| point_tracks(position.value)));
                let kept = pools.get(&point).into_iter().flatten().cloned();
                let all = only.into_iter().chain(track.into_iter().flatten()).chain(kept);
                candidates.extend(all.map(|value| (vec![point.clone()], value)));
            }
        }
        candidates
    }
}

fn type_of(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(number) if number.is_f64() => "number",
        Value::Number(_) => "integer",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    }
}

/// Values of the same type that may be valid too.
fn others(value: &Value) -> Vec<Value> {
    match value {
        Value::Bool(value) => vec![json!(!value)],
        Value::Number(number) => match number.as_i64() {
            Some(number) => {
                let others = [number + 1, number - 1, number * 2, number * 3 + 7].map(Value::from).to_vec();
                [others, near(number as f64)].concat()
            }
            None => near(number.as_f64().unwrap()),
        },
        Value::String(text) if text.starts_with('#') => vec![json!("#12f0c4")],
        Value::String(text) => {
            vec![json!(format!("{text}x")), json!("used"), json!("other"), json!(format!("({text}) * 1.3"))]
        }
        Value::Null | Value::Array(_) | Value::Object(_) => Vec::new(),
    }
}

fn near(number: f64) -> Vec<Value> {
    [number * 1.25 + 0.03, number * 0.8 - 0.02, number + 0.3, number * 0.5, number * 4.0 + 1.0, number + 40.0]
        .map(Value::from)
        .to_vec()
}

/// Formulas that could replace a number: some change over time.
fn formulas(value: &Value) -> Vec<Value> {
    let Some(from) = value.as_f64() else { return Vec::new() };
    let moving = near(from).into_iter().map(|to| format!("mix({from}, {to}, t / 3)"));
    let constant = others(value).into_iter().map(|to| format!("{to} + 0"));
    moving.chain(constant).map(|text| json!({ "expr": text })).collect()
}

/// Tracks that could replace three numbers.
fn point_tracks(value: &Value) -> Vec<Value> {
    let Some([x, y, z]) = value.as_array().map(Vec::as_slice) else { return Vec::new() };
    let Some(to) = x.as_f64().and_then(|x| near(x).into_iter().next()) else { return Vec::new() };
    vec![json!({ "keys": [[0, value], [3, [to, y, z]]], "ease": "linear" })]
}

/// Tracks that could replace a number.
fn tracks(value: &Value) -> Vec<Value> {
    let Some(from) = value.as_f64() else { return Vec::new() };
    near(from).into_iter().map(|to| json!({ "keys": [[0, from], [3, to]], "ease": "linear" })).collect()
}
