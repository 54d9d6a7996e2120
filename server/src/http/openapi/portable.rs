//! Completes the `OpenAPI` document for client generators: required bodies, files as bytes, parameters that are
//! omitted instead of null, and an example.

use serde_json::{Map, Value, json};

/// Operations whose request body is optional.
const WITHOUT_BODY: [&str; 1] = ["resubmit_job"];

/// Parameters with enumerated values, and the schemas that list them.
const WORDS: [(&str, &str); 2] = [("state", "JobState"), ("content", "LinkContent")];

/// Schemas without a Rust type: the alternatives of one status.
pub(super) fn schemas() -> Map<String, Value> {
    let answer = json!({
        "title": "SubmitAnswer",
        "description": "Result of a dry run, or the job that was accepted before with the same Idempotency-Key.",
        "anyOf": [{ "$ref": "#/components/schemas/JobView" }, { "$ref": "#/components/schemas/DryRun" }],
    });
    let changes = json!({
        "title": "JobChanges",
        "description": "Changes to a job file, as a JSON merge patch (RFC 7396): a key that is here takes the place of the \
                        file's, objects are merged, and null removes a key.",
        "type": "object",
        "additionalProperties": true,
        "examples": [{ "image": { "samples": 16 }, "priority": 5 }],
    });
    Map::from_iter([("SubmitAnswer".to_owned(), answer), ("JobChanges".to_owned(), changes)])
}

/// Rewrites every operation of the document.
pub(super) fn rewrite(document: &mut Value) {
    let Some(paths) = document["paths"].as_object_mut() else { return };
    let operations = paths.values_mut().filter_map(Value::as_object_mut).flat_map(Map::values_mut);
    for operation in operations.filter(|operation| operation["operationId"].is_string()) {
        let has_body = !WITHOUT_BODY.iter().any(|id| operation["operationId"] == *id);
        if let Some(body) = operation.get_mut("requestBody") {
            body["required"] = has_body.into();
        }
        // Indexing mutably would add a missing member, as null.
        for parameter in operation.get_mut("parameters").and_then(Value::as_array_mut).into_iter().flatten() {
            if let Some((_, words)) = WORDS.iter().find(|(name, _)| parameter["name"] == *name) {
                parameter["schema"] = json!({ "$ref": format!("#/components/schemas/{words}") });
            }
            if parameter["required"] != true
                && let Some(schema) = parameter["schema"].as_object_mut()
            {
                scene::schema::not_null(schema);
            }
        }
        for answer in operation["responses"].as_object_mut().into_iter().flat_map(Map::values_mut) {
            for (media_type, content) in answer.get_mut("content").and_then(Value::as_object_mut).into_iter().flatten()
            {
                content_of(media_type, content);
            }
        }
    }
}

/// Sets the schema of content that is not JSON to bytes or text.
fn content_of(media_type: &str, content: &mut Value) {
    let schema = if media_type.starts_with("image/") || media_type == "application/zip" {
        json!({ "type": "string", "format": "binary" })
    } else if media_type == "text/event-stream" {
        // Readers disagree on whether a schema is that of the text or of each event.
        json!({})
    } else if media_type.starts_with("text/") {
        json!({ "type": "string" })
    } else if media_type == "application/schema+json" {
        json!({ "type": "object", "additionalProperties": true })
    } else {
        return;
    };
    content["schema"] = schema;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn operations(document: &Value) -> impl Iterator<Item = (&String, &Value)> {
        document["paths"].as_object().expect("paths").values().flat_map(|path| path.as_object().expect("operations"))
    }

    #[test]
    fn bodies_are_required_and_files_are_bytes_of_one_type() {
        let mut files = 0;
        for (_, operation) in operations(&super::super::DOCUMENT) {
            let id = operation["operationId"].as_str().expect("an id");
            if operation["requestBody"].is_object() {
                assert_eq!(operation["requestBody"]["required"], id != "resubmit_job", "{id}");
            }
            for (status, answer) in operation["responses"].as_object().expect("responses") {
                assert!(
                    answer.get("content").is_none_or(Value::is_object),
                    "{id}: content of {status} is not an object"
                );
                let Some(content) = answer["content"].as_object() else { continue };
                assert_eq!(content.len(), 1, "{id} has several types for {status}");
                for (media_type, content) in content {
                    assert!(content["schema"].is_object(), "{id}: {media_type} has no schema");
                    files += usize::from(content["schema"]["format"] == "binary");
                    assert_ne!(content["schema"]["type"], "array", "{id}: {media_type}");
                }
            }
            assert!(operation.get("parameters").is_none_or(Value::is_array), "{id}: parameters are not a list");
            for parameter in operation["parameters"].as_array().into_iter().flatten() {
                let schema = &parameter["schema"];
                assert!(schema["type"].is_string() || schema["$ref"].is_string(), "{id}: {parameter}");
            }
        }
        assert!(files >= 6, "only {files} files");
    }

    #[test]
    fn operation_ids_are_unique() {
        let mut ids: Vec<&str> =
            operations(&super::super::DOCUMENT).filter_map(|(_, it)| it["operationId"].as_str()).collect();
        let count = ids.len();
        ids.sort_unstable();
        ids.dedup();
        assert_eq!(ids.len(), count, "an operation shares its id");
        assert!(count > 30, "only {count} operations");
    }
}
