//! Finds the name that was probably meant by an unknown one.

use strsim::{damerau_levenshtein, jaro_winkler};

use crate::kinds::{Kind, snake_case};

/// Maximum length of a name that is compared: longer names are not typing errors.
pub const MAX_COMPARED_CHARS: usize = 64;
/// Maximum number of names that are compared for likeness: a job may have hundreds of thousands.
const MAX_COMPARED_NAMES: usize = 2_000;
/// Minimum similarity (Jaro and Winkler's) of names with the same beginning.
const MIN_SIMILARITY: f64 = 0.88;

/// Keys and choices from other tools and common usage, each with this language's name; kinds have their aliases.
const SYNONYMS: &[(&str, &str)] = &[
    ("amplitude", "height"),
    ("angle", "degrees"),
    ("angles", "degrees"),
    ("base", "base_color"),
    ("basecolor", "base_color"),
    ("blend", "smooth"),
    ("children", "of"),
    ("color", "base_color"),
    ("color", "kd"),
    ("color", "material"),
    ("color", "ramp"),
    ("colour", "color"),
    ("by", "degrees"),
    ("emissive", "emission"),
    ("exponent", "shininess"),
    ("factor", "by"),
    ("fbm", "perlin"),
    ("field_of_view", "fov"),
    ("fov_y", "fov"),
    ("from", "position"),
    ("iblur", "smooth"),
    ("index_of_refraction", "ior"),
    ("location", "position"),
    ("lookat", "look_at"),
    ("metalness", "metallic"),
    ("offset", "by"),
    ("origin", "position"),
    ("rotation", "degrees"),
    ("smoothness", "smooth"),
    ("specular", "ks"),
    ("spin", "turntable"),
    ("spp", "samples"),
    ("target", "look_at"),
    ("translation", "by"),
    ("voronoi", "cellular"),
    ("worley", "cellular"),
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

/// The known name that was probably meant. The names of these kinds have aliases.
pub fn nearest_name<'a>(name: &str, known: &[&'a str], kinds: &[Kind]) -> Option<&'a str> {
    if name.is_empty() || name.chars().count() > MAX_COMPARED_CHARS {
        return None;
    }
    let plain = plain(name);
    let same = |other: &&&str| **other == plain || other.replace('_', "") == plain.replace('_', "");
    if let Some(same) = known.iter().find(same) {
        return Some(same);
    }
    let aliases = kinds.iter().flat_map(|kind| kind.aliases.iter().map(|alias| (*alias, kind.name.as_str())));
    let synonyms = aliases.chain(SYNONYMS.iter().copied());
    let mut meant = synonyms.filter(|(theirs, _)| *theirs == plain || theirs.replace('_', "") == plain);
    if let Some(ours) = meant.find_map(|(_, ours)| known.iter().find(|known| **known == ours)) {
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

    /// Kinds with aliases.
    fn kinds() -> [Kind; 3] {
        let kind = |name, aliases| Kind::new(name, name, aliases, Vec::new);
        [kind("Box", &["cube", "cuboid"]), kind("Sphere", &["ball"]), kind("Difference", &["subtract"])]
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
            assert_eq!(nearest_name(name, &NODES, &kinds()), Some(meant), "{name}");
        }
    }

    #[test]
    fn a_dissimilar_name_gets_no_suggestion() {
        for name in ["", "teapot", "x", "zzzzzz", &"sphere".repeat(1000)] {
            assert_eq!(nearest_name(name, &NODES, &kinds()), None, "{name}");
        }
    }

    #[test]
    fn a_synonym_suggests_a_name_of_the_list() {
        assert_eq!(nearest_name("color", &["material", "shape"], &[]), Some("material"));
        assert_eq!(nearest_name("color", &["base_color", "roughness"], &[]), Some("base_color"));
        assert_eq!(nearest_name("colour", &["color", "shadow"], &[]), Some("color"));
    }
}
