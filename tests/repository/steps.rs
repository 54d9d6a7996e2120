//! Tests what ARCHITECTURE says of the files that a new layer and a new flag take. Kinds are tested in `scene/added`,
//! routes in `server/src/http/routes.rs`.

use std::collections::BTreeSet;

use super::files;

/// Folders of the product.
const PRODUCT: [&str; 5] = ["scene", "proto", "server", "worker", "cli"];

/// Files that name every layer, besides the file of its formula and pages.
const LAYERS: [&str; 6] = [
    "proto/src/preview_helper/layer.rs",
    "scene/picture/src/film.rs",
    "scene/picture/src/mattes.rs",
    "web/studio/picture.js",
    "worker/helper/src/layer_picture.rs",
    "worker/src/picture_tape.rs",
];

/// Files that give flags to a process that they start, or write a command.
const CALLERS: [&str; 3] =
    ["cli/src/commands/export/openjd.rs", "proto/src/fail_point.rs", "server/src/pool/worker_process.rs"];

/// Sources of the product and of the page, without their tests, by their paths.
fn sources() -> Vec<(String, String)> {
    let rust = files(&PRODUCT, &["rs"]).into_iter().chain(files(&["web"], &["js"]));
    let named = rust.map(|(path, text)| (path.display().to_string().replace('\\', "/"), text));
    let product = named.filter(|(path, _)| !path.contains("tests/") && !path.ends_with("tests.rs"));
    product.map(|(path, text)| (path, text.split("#[cfg(test)]").next().unwrap_or_default().to_owned())).collect()
}

/// Words of a text: letters, digits and underscores.
fn words(text: &str) -> BTreeSet<&str> {
    text.split(|letter: char| !letter.is_alphanumeric() && letter != '_').collect()
}

/// Name in JSON of a variant.
fn snake_case(name: &str) -> String {
    let letters = name.char_indices().map(|(index, letter)| {
        let before = if letter.is_ascii_uppercase() && index > 0 { "_" } else { "" };
        format!("{before}{}", letter.to_ascii_lowercase())
    });
    letters.collect()
}

#[test]
fn six_files_name_every_layer() {
    let sources = sources();
    let (_, film) = sources.iter().find(|(path, _)| path == LAYERS[1]).expect("there");
    let (_, list) = film.split_once("pub enum Layer {").expect("the list of layers");
    let (list, _) = list.split_once('}').expect("its end");
    let lines = list.lines().map(str::trim).filter(|line| !line.starts_with("//"));
    let layers: Vec<&str> = lines.map(|line| line.trim_end_matches(',')).filter(|line| !line.is_empty()).collect();
    assert!(layers.len() > 10, "{layers:?}");
    let names: Vec<String> = layers.iter().map(|layer| snake_case(layer)).collect();
    let names_all = |text: &str| {
        let words = words(text);
        layers.iter().all(|layer| words.contains(layer)) || names.iter().all(|name| words.contains(&**name))
    };
    let mut naming: Vec<&str> =
        sources.iter().filter(|(_, text)| names_all(text)).map(|(path, _)| path.as_str()).collect();
    naming.sort_unstable();
    assert_eq!(naming, LAYERS);
}

/// Names of the flags that a file of commands declares: fields with `#[arg(long)]`.
fn flags(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for attribute in text.split("#[arg(").skip(1) {
        let Some((arguments, field)) = attribute.split_once(")]\n") else { continue };
        let mut arguments = arguments.split(',').map(str::trim);
        let Some(long) = arguments.find(|argument| *argument == "long" || argument.starts_with("long = ")) else {
            continue;
        };
        let declared = field.lines().map(str::trim).find(|line| !line.starts_with(['#', '/'])).unwrap_or_default();
        let field = declared.split(':').next().unwrap_or_default().rsplit(' ').next().unwrap_or_default();
        let named = long.strip_prefix("long = ").map(|name| name.trim_matches('"').to_owned());
        found.push(named.unwrap_or_else(|| field.replace('_', "-")));
    }
    found
}

#[test]
fn a_flag_stands_in_the_files_of_its_commands_alone() {
    let sources = sources();
    let commands = sources.iter().filter(|(path, _)| path.starts_with("cli/src/"));
    let flags: BTreeSet<String> = commands.flat_map(|(_, text)| flags(text)).collect();
    assert!(flags.len() > 90 && flags.contains("max-tile-seconds") && flags.contains("json"), "{flags:?}");
    for (path, text) in sources.iter().filter(|(path, _)| !CALLERS.contains(&path.as_str())) {
        let named: Vec<&String> = flags.iter().filter(|flag| text.contains(&format!("\"--{flag}\""))).collect();
        assert!(named.is_empty(), "{path} names {named:?}, which belong to the commands");
    }
}
