//! Suggestions for unknown names, such as "did you mean `sphere`?": the nearest known name.

use serde::de::DeserializeOwned;
use strsim::{damerau_levenshtein, jaro_winkler};

use super::form::{self, FormErrorKind};
use crate::materials::Material;
use crate::nodes::{Node, snake_case};

/// Maximum length of a list of names in a message.
const MAX_LISTED: usize = 16;
/// Maximum length of a name that is compared: longer names are not typing errors.
const MAX_COMPARED_CHARS: usize = 64;
/// Maximum number of names that are compared for likeness: a job may have hundreds of thousands.
const MAX_COMPARED_NAMES: usize = 2_000;
/// Minimum similarity (Jaro and Winkler's) of names with the same beginning.
const MIN_SIMILARITY: f64 = 0.88;

/// Names from other tools and common usage, each with this language's name.
const SYNONYMS: &[(&str, &str)] = &[
    ("aluminum", "surface"),
    ("amplitude", "height"),
    ("angle", "degrees"),
    ("angles", "degrees"),
    ("area", "sphere"),
    ("ball", "sphere"),
    ("base", "base_color"),
    ("basecolor", "base_color"),
    ("bevel", "round"),
    ("blend", "smooth"),
    ("blinn", "diffuse"),
    ("brick", "bricks"),
    ("capped_cylinder", "cylinder"),
    ("checkerboard", "checker"),
    ("chequer", "checker"),
    ("children", "of"),
    ("cloud", "clouds"),
    ("color", "base_color"),
    ("color", "kd"),
    ("color", "material"),
    ("color", "ramp"),
    ("colour", "color"),
    ("combine", "union"),
    ("constant", "flat"),
    ("cube", "box"),
    ("cuboid", "box"),
    ("cut", "difference"),
    ("by", "degrees"),
    ("dielectric", "surface"),
    ("distant", "directional"),
    ("donut", "torus"),
    ("doughnut", "torus"),
    ("emissive", "emission"),
    ("exponent", "shininess"),
    ("factor", "by"),
    ("fbm", "perlin"),
    ("field_of_view", "fov"),
    ("floor", "plane"),
    ("fov_y", "fov"),
    ("from", "position"),
    ("glass", "surface"),
    ("ground", "plane"),
    ("hollow", "onion"),
    ("iblur", "smooth"),
    ("index_of_refraction", "ior"),
    ("intersect", "intersection"),
    ("join", "union"),
    ("lambert", "diffuse"),
    ("location", "position"),
    ("lookat", "look_at"),
    ("matte", "diffuse"),
    ("merge", "union"),
    ("metal", "surface"),
    ("metalness", "metallic"),
    ("minus", "difference"),
    ("move", "translate"),
    ("ortho", "orthographic"),
    ("equirectangular", "panorama"),
    ("offset", "by"),
    ("origin", "position"),
    ("orient", "rotate"),
    ("pbr", "surface"),
    ("phong", "diffuse"),
    ("pill", "capsule"),
    ("principled", "surface"),
    ("resize", "scale"),
    ("rotation", "rotate"),
    ("rotation", "degrees"),
    ("shell", "onion"),
    ("smoothness", "smooth"),
    ("specular", "ks"),
    ("spin", "turntable"),
    ("spp", "samples"),
    ("standard", "surface"),
    ("subtract", "difference"),
    ("subtraction", "difference"),
    ("target", "look_at"),
    ("transform", "translate"),
    ("translation", "by"),
    ("tube", "infinite_cylinder"),
    ("turn", "rotate"),
    ("voronoi", "cellular"),
    ("worley", "cellular"),
    ("ring", "torus"),
    ("name", "shape"),
    ("around", "about"),
    ("target", "at"),
    ("target", "direction"),
    ("position", "by"),
    ("easing", "ease"),
    ("formula", "expr"),
    ("expression", "expr"),
    ("radians", "degrees"),
    ("r", "radius"),
    ("axis", "normal"),
    ("child", "of"),
    ("gloss", "roughness"),
    ("focal_length", "fov"),
    ("dof", "lens"),
    ("depth_of_field", "lens"),
    ("fstop", "f_stop"),
    ("f_number", "f_stop"),
    ("focus_distance", "focus"),
    ("focal_distance", "focus"),
    ("lens_radius", "aperture"),
    ("aperture", "lens"),
    ("rotation", "turn"),
    ("sides", "blades"),
    ("temperature", "kelvin"),
    ("intensity", "strength"),
    ("intensity", "color"),
    ("power", "color"),
    ("sunlight", "directional"),
    ("rectangle", "box"),
    ("square", "rectangle"),
    ("text", "string"),
    ("musgrave", "perlin"),
    ("jpg", "png"),
    ("jpeg", "png"),
    ("aces", "filmic"),
    ("z", "depth"),
    ("alternate", "ping_pong"),
    ("forever", "repeat"),
    ("quadratic", "ease_in_out"),
    ("elastic_out", "bounce_out"),
    ("elastic_in", "bounce_in"),
];

/// The unknown name in a message of serde, and the known names; `prefix` begins the message.
pub(super) fn unknown<'a>(message: &'a str, prefix: &str) -> Option<(&'a str, Vec<&'a str>)> {
    let rest = message.strip_prefix(prefix)?;
    if let Some((name, known)) = rest.rsplit_once("`, expected ") {
        return Some((name, known.split('`').skip(1).step_by(2).collect()));
    }
    let (name, _) = rest.rsplit_once("`, there are no ")?;
    Some((name, Vec::new()))
}

/// The known name that was probably meant.
pub(crate) fn nearest<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    if name.is_empty() || name.chars().count() > MAX_COMPARED_CHARS {
        return None;
    }
    let plain = plain(name);
    let same = |other: &&&str| **other == plain || other.replace('_', "") == plain.replace('_', "");
    if let Some(same) = known.iter().find(same) {
        return Some(same);
    }
    let mut meant = SYNONYMS.iter().filter(|(theirs, _)| *theirs == plain || theirs.replace('_', "") == plain);
    if let Some(ours) = meant.find_map(|(_, ours)| known.iter().find(|known| *known == ours)) {
        return Some(ours);
    }
    if known.len() > MAX_COMPARED_NAMES {
        return None;
    }
    let most = (plain.chars().count() / 3).max(1);
    let by_edits = known.iter().map(|known| (damerau_levenshtein(&plain, known), *known));
    let nearest = by_edits.filter(|&(edits, known)| edits <= most && edits < known.chars().count()).min();
    let alike = || {
        let alike = known.iter().map(|known| (jaro_winkler(&plain, known), *known));
        alike.filter(|(similarity, _)| *similarity >= MIN_SIMILARITY).max_by(|a, b| a.0.total_cmp(&b.0))
    };
    nearest.map(|(_, known)| known).or_else(|| alike().map(|(_, known)| known))
}

/// Normalizes `RoundedCylinder`, `rounded-cylinder` and `ROUNDED CYLINDER` to `snake_case`.
fn plain(name: &str) -> String {
    let is_shouted = !name.chars().any(|letter| letter.is_ascii_lowercase());
    let name = if is_shouted { name.to_ascii_lowercase() } else { snake_case(name) };
    name.trim().replace(['-', ' ', '.'], "_").replace("__", "_")
}

/// Message for an unknown name.
pub(super) fn unknown_name(name: &str, known: &[&str]) -> String {
    let name = shortened(name);
    match nearest(&name, known) {
        Some(meant) => format!("there is no `{name}`: did you mean `{meant}`?"),
        None if name == "type" || name == "kind" => {
            format!("there is no `{name}`: the kind is the key itself, so write {{ \"KIND\": {{ … }} }}")
        }
        None if name.starts_with('#') && known.contains(&"color") => {
            format!("there is no `{name}`: write {{ \"color\": \"{name}\" }}")
        }
        None if known.len() > MAX_LISTED => {
            format!("there is no `{name}`: choose one of the {} in docs/nodes.md, or in `sdfarm schema`", known.len())
        }
        None => format!("there is no `{name}`: choose {}", listed(known)),
    }
}

/// Message for an unknown key of an object.
pub(super) fn unknown_key(key: &str, known: &[&str]) -> String {
    let key = shortened(key);
    match nearest(&key, known) {
        Some(meant) => format!("unknown key `{key}`: did you mean `{meant}`?"),
        None if known == ["material", "shape"] && is_kind::<Node>(&key) => {
            format!("unknown key `{key}`: write {{ \"shape\": {{ \"{key}\": {{ … }} }} }}")
        }
        None if known.is_empty() => format!("unknown key `{key}`: leave it out, because no keys are allowed here"),
        None => format!("unknown key `{key}`: leave it out, or choose {}", listed(known)),
    }
}

/// Message for a material name that is not defined.
pub(super) fn unknown_material(name: &str, known: &[&str]) -> String {
    if is_kind::<Material>(name) {
        return format!(
            "\"{name}\" is not in /scene/materials: write {{ \"{name}\": {{ … }} }} for a material in place"
        );
    }
    undefined(name, known, "materials", "material")
}

/// Message for a name of a shape that is not defined.
pub(super) fn unknown_shape(name: &str, known: &[&str]) -> String {
    if is_kind::<Node>(name) {
        return format!("\"{name}\" is not in /scene/shapes: write {{ \"{name}\": {{ … }} }} without `use`");
    }
    undefined(name, known, "shapes", "shape")
}

/// Whether a choice has a kind of this name.
fn is_kind<T: DeserializeOwned>(name: &str) -> bool {
    let text = format!("{{{}:{{}}}}", serde_json::Value::from(name));
    let fault = form::read::<T>(&text).err();
    fault.is_none_or(|fault| !matches!(fault.kind, FormErrorKind::UnknownName(_)))
}

/// Message for a name that is not a key of an object of the scene.
fn undefined(name: &str, known: &[&str], object: &str, kind: &str) -> String {
    let name = shortened(name);
    let cure = match nearest(&name, known) {
        Some(meant) => format!("did you mean \"{meant}\"?"),
        None if known.is_empty() => format!("define it there, or write a {kind} in place"),
        None if known.len() > MAX_LISTED => {
            format!("define it there, or use one of the {} that are defined", known.len())
        }
        None => format!("choose one of {}", known.join(", ")),
    };
    format!("\"{name}\" is not in /scene/{object}: {cure}")
}

/// "`a`", "`a` or `b`", "one of `a`, `b`, `c`".
fn listed(known: &[&str]) -> String {
    let quoted: Vec<String> = known.iter().map(|name| format!("`{name}`")).collect();
    match quoted.as_slice() {
        [one, other] => format!("{one} or {other}"),
        [_, _, ..] => format!("one of {}", quoted.join(", ")),
        rest => rest.concat(),
    }
}

/// A name, shortened for a message.
fn shortened(name: &str) -> String {
    if name.chars().count() <= MAX_COMPARED_CHARS {
        return name.to_owned();
    }
    let start: String = name.chars().take(MAX_COMPARED_CHARS).collect();
    format!("{start}…")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_compared_in_snake_case() {
        for name in ["rounded_cylinder", "RoundedCylinder", "rounded-cylinder", "ROUNDED CYLINDER", "Rounded.Cylinder"]
        {
            assert_eq!(plain(name), "rounded_cylinder", "{name}");
        }
    }

    const NODES: [&str; 11] = [
        "sphere",
        "box",
        "torus",
        "union",
        "difference",
        "rounded_cylinder",
        "capsule",
        "cone",
        "plane",
        "translate",
        "rotate",
    ];

    #[test]
    fn typos_and_names_from_other_tools_get_suggestions() {
        for (name, meant) in [
            ("spere", "sphere"),
            ("shpere", "sphere"),
            ("Sphere", "sphere"),
            ("SPHERE", "sphere"),
            ("spheres", "sphere"),
            ("RoundedCylinder", "rounded_cylinder"),
            ("rounded-cylinder", "rounded_cylinder"),
            ("roundedCylinder", "rounded_cylinder"),
            ("roundedcylinder", "rounded_cylinder"),
            ("cube", "box"),
            ("Cuboid", "box"),
            ("ball", "sphere"),
            ("subtract", "difference"),
            ("boxx", "box"),
            ("trans", "translate"),
        ] {
            assert_eq!(nearest(name, &NODES), Some(meant), "{name}");
        }
    }

    #[test]
    fn a_dissimilar_name_gets_no_suggestion() {
        for name in ["", "teapot", "x", "zzzzzz", &"sphere".repeat(1000)] {
            assert_eq!(nearest(name, &NODES), None, "{name}");
        }
    }

    #[test]
    fn a_synonym_suggests_a_name_of_the_list() {
        assert_eq!(nearest("color", &["material", "shape"]), Some("material"));
        assert_eq!(nearest("color", &["base_color", "roughness"]), Some("base_color"));
        assert_eq!(nearest("colour", &["color", "shadow"]), Some("color"));
    }

    #[test]
    fn name_lists_of_any_length_are_parsed() {
        let of = |message| unknown(message, "unknown field `");
        assert_eq!(of("unknown field `x`, expected `a`"), Some(("x", vec!["a"])));
        assert_eq!(of("unknown field `x`, expected `a` or `b`"), Some(("x", vec!["a", "b"])));
        assert_eq!(of("unknown field `x`, expected one of `a`, `b`, `c`"), Some(("x", vec!["a", "b", "c"])));
        assert_eq!(of("unknown field `x`, there are no fields"), Some(("x", vec![])));
        assert_eq!(of("unknown field ``, expected ``, expected `a`"), Some(("`, expected `", vec!["a"])));
        assert_eq!(of("missing field `x`"), None);
    }

    #[test]
    fn long_lists_are_not_printed() {
        let names: Vec<String> = (0..99).map(|number| format!("name_{number}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let told = unknown_name("zzz", &names);
        assert!(told.contains("docs/nodes.md") && told.contains("99") && told.len() < 120, "{told}");
        assert!(unknown_name("zzz", &names[..3]).contains("one of `name_0`, `name_1`, `name_2`"));
        assert!(unknown_key("zzz", &[]).contains("no key"));
    }
}
