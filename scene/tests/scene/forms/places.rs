//! The places of a job where a number, a point, a color or a shape stands, by the schema of jobs; and which values the schema
//! allows there.

use serde_json::{Map, Value};

/// Kinds of values that may stand at a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Number,
    Point,
    Color,
    Node,
}

/// A value in a job.
#[derive(Clone, Debug)]
pub(super) struct JobValue {
    /// Its JSON pointer in the job.
    pub(super) pointer: String,
    /// Pointer in the schema to what is allowed there.
    pub(super) schema: String,
    /// Pointer in the schema to the property that it is, or is in.
    pub(super) property: String,
    pub(super) kind: Kind,
    pub(super) value: Value,
}

impl JobValue {
    /// Whether it is in a shape or a material with a name, which may be unused.
    pub(super) fn is_named(&self) -> bool {
        self.pointer.starts_with("/scene/shapes/") || self.pointer.starts_with("/scene/materials/")
    }
}

/// Schema of job files.
pub(super) struct Schema(Value);

/// Pointer and value of the first number that a formula may replace: in a shape, all that are no counts.
pub(super) fn first_number(shape: &Value) -> Option<(String, Value)> {
    fn find(value: &Value, pointer: String) -> Option<(String, Value)> {
        match value {
            Value::Number(_) => Some((pointer, value.clone())),
            Value::Object(members) if !members.contains_key("keys") && !members.contains_key("use") => {
                members.iter().find_map(|(key, value)| find(value, format!("{pointer}/{key}")))
            }
            Value::Array(entries) => {
                entries.iter().enumerate().find_map(|(index, value)| find(value, format!("{pointer}/{index}")))
            }
            Value::Null | Value::Bool(_) | Value::String(_) | Value::Object(_) => None,
        }
    }
    find(shape, String::new())
}

impl Schema {
    pub(super) fn new(schema: Value) -> Self {
        Self(schema)
    }

    fn at(&self, pointer: &str) -> &Map<String, Value> {
        let schema = self.0.pointer(&pointer[1..]).unwrap_or_else(|| panic!("no {pointer} in the schema"));
        schema.as_object().unwrap_or_else(|| panic!("{pointer} is no schema"))
    }

    /// The places of a job.
    pub(super) fn places(&self, job: &Value) -> Vec<JobValue> {
        let mut places = Vec::new();
        self.walk("#", "#", job, &mut String::new(), &mut places);
        places
    }

    fn walk(&self, schema: &str, property: &str, value: &Value, pointer: &mut String, places: &mut Vec<JobValue>) {
        let (mut met, mut is_track) = (Vec::new(), false);
        self.meet(schema, value, &mut met);
        if let Some(kind) = Self::kind(&met, value) {
            let (schema, property) = (schema.to_owned(), property.to_owned());
            places.push(JobValue { pointer: pointer.clone(), schema, property, kind, value: value.clone() });
        }
        is_track |= met
            .iter()
            .any(|schema| ["Track", "PointTrack", "ColorTrack", "Formula"].iter().any(|name| is(schema, name)));
        if is_track {
            return;
        }
        let length = pointer.len();
        for schema in met {
            let keywords = self.at(&schema);
            for (key, value) in value.as_object().into_iter().flatten() {
                let inside = if keywords.get("properties").is_some_and(|properties| properties.get(key).is_some()) {
                    format!("{schema}/properties/{key}")
                } else if keywords.get("additionalProperties").is_some_and(Value::is_object) {
                    format!("{schema}/additionalProperties")
                } else {
                    continue;
                };
                pointer.extend(["/", &key.replace('~', "~0").replace('/', "~1")]);
                self.walk(&inside, &inside, value, pointer, places);
                pointer.truncate(length);
            }
            for (index, value) in value.as_array().into_iter().flatten().enumerate() {
                let inside = if keywords.get("prefixItems").is_some_and(|items| items.get(index).is_some()) {
                    format!("{schema}/prefixItems/{index}")
                } else if keywords.contains_key("items") {
                    format!("{schema}/items")
                } else {
                    continue;
                };
                pointer.extend(["/", &index.to_string()]);
                self.walk(&inside, &format!("{property} > {inside}"), value, pointer, places);
                pointer.truncate(length);
            }
        }
    }

    /// The schemas that a value meets: one, those that it refers to, and the alternatives that allow the value.
    fn meet(&self, schema: &str, value: &Value, met: &mut Vec<String>) {
        met.push(schema.to_owned());
        let keywords = self.at(schema);
        if let Some(Value::String(next)) = keywords.get("$ref") {
            self.meet(next, value, met);
        }
        for keyword in ["anyOf", "oneOf"] {
            let count = keywords.get(keyword).and_then(Value::as_array).map_or(0, Vec::len);
            let all = (0..count).map(|index| format!("{schema}/{keyword}/{index}"));
            if let Some(alternative) = all.into_iter().find(|alternative| self.allows(alternative, value)) {
                self.meet(&alternative, value, met);
            }
        }
    }

    fn kind(met: &[String], value: &Value) -> Option<Kind> {
        let is_any = |name: &str| met.iter().any(|schema| is(schema, name));
        match value {
            Value::Number(_) if !is_any("NamedNumber") => Some(Kind::Number),
            Value::Array(_) if is_any("Point") || is_any("Direction") || is_any("Rotation") => Some(Kind::Point),
            Value::Object(_) if is_any("Node") => Some(Kind::Node),
            _ if is_any("Color") => Some(Kind::Color),
            _ => None,
        }
    }

    /// Whether the schema at a pointer allows a value. Patterns of texts are taken as met.
    pub(super) fn allows(&self, schema: &str, value: &Value) -> bool {
        let keywords = self.at(schema);
        let inside = |keyword: &str| format!("{schema}/{keyword}");
        keywords.iter().all(|(keyword, wanted)| match keyword.as_str() {
            "$ref" => self.allows(wanted.as_str().expect("a reference"), value),
            "type" => match wanted {
                Value::Array(types) => types.iter().any(|name| is_type(name, value)),
                one => is_type(one, value),
            },
            "const" => wanted == value,
            "enum" => wanted.as_array().is_some_and(|all| all.contains(value)),
            "anyOf" | "oneOf" => {
                let count = wanted.as_array().map_or(0, Vec::len);
                (0..count).any(|index| self.allows(&format!("{schema}/{keyword}/{index}"), value))
            }
            "not" => !self.allows(&inside("not"), value),
            "minimum" | "maximum" | "exclusiveMinimum" | "exclusiveMaximum" => {
                let (Some(value), Some(limit)) = (value.as_f64(), wanted.as_f64()) else { return true };
                match keyword.as_str() {
                    "minimum" => value >= limit,
                    "maximum" => value <= limit,
                    "exclusiveMinimum" => value > limit,
                    _ => value < limit,
                }
            }
            "minItems" => value.as_array().is_none_or(|entries| entries.len() as u64 >= wanted.as_u64().unwrap_or(0)),
            "maxItems" => {
                value.as_array().is_none_or(|entries| entries.len() as u64 <= wanted.as_u64().unwrap_or(u64::MAX))
            }
            "required" => value.as_object().is_none_or(|members| {
                wanted
                    .as_array()
                    .is_some_and(|keys| keys.iter().all(|key| members.contains_key(key.as_str().unwrap_or_default())))
            }),
            "properties" => value.as_object().into_iter().flatten().all(|(key, value)| {
                // The parser takes null for a key that is left out.
                let is_left_out = value.is_null();
                is_left_out || wanted.get(key).is_none() || self.allows(&format!("{schema}/properties/{key}"), value)
            }),
            "additionalProperties" => value.as_object().into_iter().flatten().all(|(key, value)| {
                let is_known = keywords.get("properties").is_some_and(|properties| properties.get(key).is_some());
                is_known
                    || if wanted.is_object() {
                        self.allows(&inside("additionalProperties"), value)
                    } else {
                        *wanted != false
                    }
            }),
            "prefixItems" => value.as_array().into_iter().flatten().enumerate().all(|(index, value)| {
                wanted.get(index).is_none() || self.allows(&format!("{schema}/prefixItems/{index}"), value)
            }),
            "items" if wanted.is_object() => {
                let skipped = keywords.get("prefixItems").and_then(Value::as_array).map_or(0, Vec::len);
                value.as_array().into_iter().flatten().skip(skipped).all(|value| self.allows(&inside("items"), value))
            }
            "maxLength" | "minLength" | "pattern" | "items" | "$schema" | "$id" | "$defs" | "title" | "description"
            | "default" | "examples" | "format" | "writeOnly" => true,
            other => panic!("{schema} has {other}, which this test does not know"),
        })
    }
}

/// Whether a pointer in the schema is that of the definition of this name.
fn is(schema: &str, name: &str) -> bool {
    schema.strip_prefix("#/$defs/") == Some(name)
}

fn is_type(name: &Value, value: &Value) -> bool {
    match name.as_str().expect("a type") {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "integer" => value.as_f64().is_some_and(|number| number.fract() == 0.0),
        "number" => value.is_number(),
        "string" => value.is_string(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        other => panic!("{other} is no type"),
    }
}
