//! `OpenAPI` document of the API: routes from their handlers, schemas from the types that are sent.

mod portable;
mod problems;

use std::sync::LazyLock;

use axum::Json;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use proto::Problem;
use proto::alert::AlertList;
use proto::api_key::{ApiKeyList, IssuedApiKey, NewApiKey};
use proto::audit::AuditPage;
use proto::caller::CallerView;
use proto::farm::{FarmView, StartView};
use proto::frame::{ForgottenPicture, FramePage};
use proto::history::HistoryView;
use proto::job::{DeleteDryRun, JobMove, JobPatch};
use proto::job::{DryRun, JobPage, JobView};
use proto::link::{LinkRequest, LinkView};
use proto::pool::{PoolSize, PoolView, WorkerList};
use proto::preview_helper::{LayersView, PickView, PixelView, ShaderView};
use proto::price::Price;
use proto::retention::GcReport;
use proto::scaling::ScalingView;
use proto::shipped_scenes::SceneList;
use proto::tile_history::TilePage;
use proto::verify::Verification;
use proto::webhook::DeliveryList;
use scene::schema::NodeTable;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value};
use utoipa::openapi::OpenApi;

use crate::http::ROUTES;

/// Location of the definitions in the `OpenAPI` document.
const COMPONENTS: &str = "#/components/schemas/";
/// Location of the definitions in a JSON Schema.
const DEFINITIONS: &str = "#/$defs/";

/// `OpenAPI` document, as it is served.
static DOCUMENT: LazyLock<Value> = LazyLock::new(document);

/// Joins the routes of the table, and the schemas that they refer to.
fn document() -> Value {
    let mut document = serde_json::to_value(OpenApi::default()).expect("an OpenAPI document is plain JSON");
    for route in ROUTES {
        let Some(description) = &route.description else { continue };
        let mut described = serde_json::to_value((description.operation)()).expect("a description is plain JSON");
        let method = route.method.as_str().to_lowercase();
        let mut operation = described[""][&method].take();
        problems::describe(&mut operation, &route.policy, description.errors);
        document["paths"][route.path][method] = operation;
    }
    document["info"] = serde_json::json!({
        "title": "sdfarm",
        "version": env!("CARGO_PKG_VERSION"),
        "description": "A render farm for scenes made of signed distance functions.",
        "license": { "name": "MIT OR Apache-2.0" },
    });
    let mut schemas = views();
    schemas.extend(job_file());
    document["components"]["schemas"] = Value::Object(schemas);
    document["components"]["securitySchemes"] = problems::security_schemes();
    portable::rewrite(&mut document);
    document
}

/// Schemas of the responses, and of request bodies other than jobs.
fn views() -> Map<String, Value> {
    let mut schemas = requests();
    // Responses have every member, including those that are null.
    schemas.extend(answers());
    scene::schema::tidy(&mut schemas, COMPONENTS);
    schemas.extend(portable::schemas());
    schemas
}

fn settings() -> SchemaSettings {
    SchemaSettings::draft2020_12().with(|settings| settings.definitions_path = "/components/schemas".into())
}

fn requests() -> Map<String, Value> {
    let mut generator = settings().into_generator();
    generator.subschema_for::<JobPatch>();
    generator.subschema_for::<JobMove>();
    generator.subschema_for::<LinkRequest>();
    generator.subschema_for::<PoolSize>();
    generator.subschema_for::<NewApiKey>();
    generator.take_definitions(true)
}

fn answers() -> Map<String, Value> {
    let mut generator = settings().for_serialize().into_generator();
    generator.subschema_for::<JobView>();
    generator.subschema_for::<JobPage>();
    generator.subschema_for::<DryRun>();
    generator.subschema_for::<ShaderView>();
    generator.subschema_for::<DeleteDryRun>();
    generator.subschema_for::<FarmView>();
    generator.subschema_for::<AlertList>();
    generator.subschema_for::<HistoryView>();
    generator.subschema_for::<StartView>();
    generator.subschema_for::<LinkView>();
    generator.subschema_for::<GcReport>();
    generator.subschema_for::<FramePage>();
    generator.subschema_for::<ForgottenPicture>();
    generator.subschema_for::<Verification>();
    generator.subschema_for::<Price>();
    generator.subschema_for::<DeliveryList>();
    generator.subschema_for::<TilePage>();
    generator.subschema_for::<WorkerList>();
    generator.subschema_for::<PickView>();
    generator.subschema_for::<LayersView>();
    generator.subschema_for::<PixelView>();
    generator.subschema_for::<NodeTable>();
    generator.subschema_for::<SceneList>();
    generator.subschema_for::<PoolView>();
    generator.subschema_for::<ScalingView>();
    generator.subschema_for::<IssuedApiKey>();
    generator.subschema_for::<ApiKeyList>();
    generator.subschema_for::<CallerView>();
    generator.subschema_for::<AuditPage>();
    generator.subschema_for::<Problem>();
    generator.take_definitions(true)
}

/// Schema of a job file, with all schemas that it refers to.
fn job_file() -> Map<String, Value> {
    let mut schema = scene::schema();
    let Some(job) = schema.as_object_mut() else { return Map::new() };
    job.remove("$schema");
    let mut schemas = match job.remove("$defs") {
        Some(Value::Object(definitions)) => definitions,
        _ => Map::new(),
    };
    schemas.insert("Job".to_owned(), schema);
    for definition in schemas.values_mut() {
        rewrite_refs(definition);
    }
    schemas
}

fn rewrite_refs(value: &mut Value) {
    match value {
        Value::Object(members) => {
            for (key, member) in members {
                match member {
                    Value::String(target) if key == "$ref" => {
                        if let Some(name) = target.strip_prefix(DEFINITIONS) {
                            *target = format!("{COMPONENTS}{name}");
                        }
                    }
                    member => rewrite_refs(member),
                }
            }
        }
        Value::Array(members) => members.iter_mut().for_each(rewrite_refs),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
    }
}

/// Get the `OpenAPI` document.
pub(in crate::http) async fn openapi() -> Json<&'static Value> {
    Json(&DOCUMENT)
}

/// Get the JSON Schema of a job file.
#[utoipa::path(
    get, path = "", tag = "schemas", operation_id = "job_schema",
    responses((status = 200, description = "JSON Schema 2020-12", body = serde_json::Value, content_type = "application/schema+json"))
)]
pub(in crate::http) async fn job_schema() -> Response {
    ([(header::CONTENT_TYPE, "application/schema+json")], scene::editor_schema().to_string()).into_response()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use serde::Serialize;
    use serde_json::ser::{PrettyFormatter, Serializer};

    use super::*;

    /// The document as text for `docs/openapi.json`, without the release that serves it.
    fn text() -> String {
        let mut document = DOCUMENT.clone();
        document["info"]["version"] = "".into();
        let mut text = Vec::new();
        let mut serializer = Serializer::with_formatter(&mut text, PrettyFormatter::with_indent(b" "));
        document.serialize(&mut serializer).expect("a document is plain JSON");
        text.push(b'\n');
        String::from_utf8(text).expect("JSON is UTF-8")
    }

    /// A change of the API shows in `docs/openapi.json`.
    #[test]
    fn the_document_is_the_one_in_docs() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/openapi.json");
        if std::env::var_os("SDFARM_WRITE_DOCS").is_some() {
            return std::fs::write(path, text()).expect("written");
        }
        let kept = std::fs::read_to_string(path).expect("the document is readable");
        let first = kept.lines().zip(text().lines()).position(|(kept, now)| kept != now);
        assert!(
            kept == text(),
            "docs/openapi.json differs from line {}: SDFARM_WRITE_DOCS=1 cargo test -p server --lib openapi rewrites it",
            first.map_or_else(|| "its end".to_owned(), |line| (line + 1).to_string())
        );
    }

    #[test]
    fn job_and_response_schemas_have_distinct_names() {
        let views = views();
        let shared: Vec<String> =
            job_file().into_iter().map(|(name, _)| name).filter(|name| views.contains_key(name)).collect();
        assert_eq!(shared, Vec::<String>::new());
    }

    #[test]
    fn the_document_describes_jobs_by_their_schema() {
        let mut schema = scene::schema();
        rewrite_refs(&mut schema);
        let served = &DOCUMENT["components"]["schemas"];
        for (name, definition) in schema["$defs"].as_object().expect("definitions") {
            assert_eq!(served[name], *definition, "{name}");
        }
        assert_eq!(served["Job"]["properties"], schema["properties"]);
    }

    #[test]
    fn every_reference_has_a_schema() {
        let text = DOCUMENT.to_string();
        let schemas = DOCUMENT["components"]["schemas"].as_object().expect("schemas");
        let mut count = 0;
        for rest in text.split("\"$ref\":\"").skip(1) {
            let target = rest.split('"').next().expect("a reference has a closing quote");
            let name = target.strip_prefix(COMPONENTS).unwrap_or_else(|| panic!("{target} leads out"));
            assert!(schemas.contains_key(name), "{name} is missing");
            count += 1;
        }
        assert!(count > 30, "only {count} references");
    }
}
