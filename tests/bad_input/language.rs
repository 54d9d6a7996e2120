//! Invalid shapes, materials, lights, and skies: numbers out of range, alone or combined, and values of wrong types.

use super::{Case, LOOK_AT, SPHERE, changed};

/// Replaces the shape of the valid job; the pointer begins at the shape.
fn shape(name: &'static str, marked: &str, pointer: &str, says: &'static str) -> Case {
    changed(name, SPHERE, marked, &format!("/scene/objects/0/shape{pointer}"), says)
}

/// Replaces the material of the valid job; the pointer begins at the material.
fn material(name: &'static str, marked: &str, pointer: &str, says: &'static str) -> Case {
    let pointer = format!("/scene/objects/0/material{pointer}");
    changed(name, r#""material": "clay""#, &format!(r#""material": {marked}"#), &pointer, says)
}

/// Adds a member to the scene of the valid job; the pointer begins at the scene.
fn scene(name: &'static str, marked: &str, pointer: &str, says: &'static str) -> Case {
    changed(name, r#""materials""#, &format!(r#"{marked}, "materials""#), &format!("/scene{pointer}"), says)
}

/// Wraps the sphere in a node.
fn around(name: &'static str, node: &str, pointer: &str, says: &'static str) -> Case {
    shape(name, &node.replacen("CHILD", SPHERE, 9), pointer, says)
}

fn bumps(name: &'static str, noise: &str, pointer: &str, says: &'static str) -> Case {
    let node = format!(r#"{{ "displace": {{ "by": {{ "noise": {noise} }}, "amplitude": 0.1, "child": CHILD }} }}"#);
    around(name, &node, &format!("/displace/by/noise{pointer}"), says)
}

fn extruded(name: &'static str, profile: &str, pointer: &str, says: &'static str) -> Case {
    let node = format!(r#"{{ "extrude": {{ "profile": {profile}, "height": 1 }} }}"#);
    shape(name, &node, &format!("/extrude/profile{pointer}"), says)
}

fn shapes() -> Vec<Case> {
    let long = format!(r#"{{ "text": {{ "string": ¤"{}", "size": 1 }} }}"#, "a".repeat(65));
    vec![
        shape(
            "radius that swallows its torus",
            r#"{ "torus": { "radius": 0.5, "tube": ¤1 } }"#,
            "/torus/tube",
            "less than 0.5",
        ),
        around(
            "repeat of cell 0",
            r#"{ "repeat": { "cell": [¤0, 3, 3], "child": CHILD } }"#,
            "/repeat/cell/0",
            "null along an axis",
        ),
        around(
            "repeat along no axis",
            r#"{ "repeat": { "cell": ¤[null, null, null], "child": CHILD } }"#,
            "/repeat/cell",
            "give x, y or z",
        ),
        around(
            "10⁹ copies",
            r#"{ "repeat": { "cell": [3, 3, 3], "count": [¤1e9, 1, 1], "child": CHILD } }"#,
            "/repeat/count/0",
            "1 to 1000000 copies",
        ),
        around(
            "no copies around",
            r#"{ "polar_repeat": { "count": ¤0, "child": CHILD } }"#,
            "/polar_repeat/count",
            "1 to 10000 copies",
        ),
        around(
            "twist of an endless shape",
            r#"{ "twist": { "degrees_per_unit": 90, "child": ¤{ "plane": { "normal": [0, 1, 0], "offset": 0 } } } }"#,
            "/twist/child",
            "intersection",
        ),
        around(
            "morph of three shapes",
            r#"{ "morph": { "of": ¤[CHILD, CHILD, CHILD], "amount": 0.5 } }"#,
            "/morph/of",
            "exactly 2",
        ),
        around(
            "scale of an axis each",
            r#"{ "scale": { "by": ¤[1, 2, 1], "child": CHILD } }"#,
            "/scale/by",
            "not a list; a factor for each axis is written in stretch",
        ),
        around(
            "stretch by a negative factor",
            r#"{ "stretch": { "by": [¤-1, 1, 1], "child": CHILD } }"#,
            "/stretch/by/0",
            "not -1; mirror reflects a shape",
        ),
        around("scale of 0", r#"{ "scale": { "by": ¤0, "child": CHILD } }"#, "/scale/by", "from 1e-6"),
        shape(
            "fractal without end",
            r#"{ "mandelbulb": { "power": 8, "iterations": ¤999 } }"#,
            "/mandelbulb/iterations",
            "1 to 64 iterations",
        ),
        shape("extrude without a profile", r#"{ "extrude": ¤{ "height": 1 } }"#, "/extrude", "profile"),
        extruded(
            "polygon that crosses itself",
            r#"{ "polygon": { "points": [[0, 0], [1, 1], ¤[1, 0], [0, 1]] } }"#,
            "/polygon/points/2",
            "in the order of a walk",
        ),
        extruded(
            "polygon of two points",
            r#"{ "polygon": { "points": ¤[[0, 0], [1, 1]] } }"#,
            "/polygon/points",
            "3 to 256",
        ),
        extruded(
            "letter that the font lacks",
            r#"{ "text": { "string": ¤"h中", "size": 1 } }"#,
            "/text/string",
            "Latin letters",
        ),
        extruded("text of 65 characters", &long, "/text/string", "at most 64"),
        extruded(
            "text that shows nothing",
            r#"{ "text": { "string": ¤" ", "size": 1 } }"#,
            "/text/string",
            "a letter or more",
        ),
        bumps("99 octaves", r#"{ "perlin": { "octaves": ¤99 } }"#, "/perlin/octaves", "1 to 12 octaves"),
        bumps("noise that there is not", r#"{ ¤"worley": {} }"#, "/worley", "cellular"),
        bumps(
            "feature that there is not",
            r#"{ "cellular": { "feature": ¤"f3" } }"#,
            "/cellular/feature",
            "did you mean `f1`",
        ),
        bumps("nine waves", r#"{ "gardner": { "waves": ¤9 } }"#, "/gardner/waves", "3 to 8 waves"),
        bumps("noise without its parameters", r#"¤"perlin""#, "", r#"write { "perlin": { … } }"#),
    ]
}

fn forms() -> Vec<Case> {
    vec![
        shape(
            "shape of two kinds",
            r#"¤{ "sphere": { "radius": 1 }, "box": { "size": [1, 1, 1] } }"#,
            "",
            "has 2 keys",
        ),
        shape("shape of no kind", "¤{}", "", "is empty"),
        shape("shape that is a number", "¤7", "", "one key"),
        shape("name of a shape alone", r#"¤"sphere""#, "", r#"write { "sphere": { … } }"#),
        shape("list in place of an object", r#"{ "sphere": ¤[1] }"#, "/sphere", "must be an object"),
        shape("number in place of an object", r#"{ "sphere": ¤1 }"#, "/sphere", "must be an object, not 1"),
        around(
            "four coordinates",
            r#"{ "translate": { "by": ¤[1, 2, 3, 4], "child": CHILD } }"#,
            "/translate/by",
            "has 4 entries",
        ),
        around(
            "two coordinates",
            r#"{ "translate": { "by": ¤[1, 2], "child": CHILD } }"#,
            "/translate/by",
            "a list of 3 numbers",
        ),
        around(
            "object in place of a list",
            r#"{ "union": { "of": ¤{} } }"#,
            "/union/of",
            "must be a list, not an object",
        ),
        changed("whole picture", r#""width": 32"#, r#""width": ¤32.5"#, "/image/width", "whole number, not 32.5"),
    ]
}

fn materials() -> Vec<Case> {
    let nested = format!(
        r#"{{ "flat": {{ "color": ¤{}{{ "checker": {{ "cell": 1 }} }}{} }} }}"#,
        r##"{ "checker": { "cell": 1, "colors": ["#000000", "##.repeat(4),
        "] } }".repeat(4)
    );
    let ramp = |stops: &str| {
        format!(r#"{{ "flat": {{ "color": {{ "noise": {{ "noise": {{ "perlin": {{}} }}, "ramp": {stops} }} }} }} }}"#)
    };
    vec![
        material(
            "ramp out of order",
            &ramp(r##"[[0.5, "#000000"], ¤[0.2, "#ffffff"]]"##),
            "/flat/color/noise/ramp/1",
            "put stops in order",
        ),
        material("ramp without stops", &ramp("¤[]"), "/flat/color/noise/ramp", "at least 2 stops"),
        material(
            "stop beyond the end",
            &ramp(r##"[[0, "#000000"], [¤2, "#ffffff"]]"##),
            "/flat/color/noise/ramp/1/0",
            "from 0 to 1",
        ),
        material(
            "texture on a number",
            r#"{ "surface": { "roughness": ¤{ "checker": { "cell": 1 } } } }"#,
            "/surface/roughness",
            "\"by\"",
        ),
        material(
            "texture on what can't take one",
            r#"{ "volume": { "density": ¤{ "checker": { "cell": 1 } } } }"#,
            "/volume/density",
            "takes no texture",
        ),
        material(
            "texture on a color that can't take one",
            r#"{ "volume": { "density": 1, "albedo": ¤{ "checker": { "cell": 1 } } } }"#,
            "/volume/albedo",
            "takes no texture",
        ),
        material("textures five deep", &nested, "/flat/color", "at most 4"),
        material(
            "texture that there is not",
            r#"{ "flat": { "color": { ¤"plaid": {} } } }"#,
            "/flat/color/plaid",
            "checker",
        ),
        material(
            "three colors of two",
            r##"{ "flat": { "color": { "checker": { "cell": 1, "colors": ¤["#000000", "#000000", "#000000"] } } } }"##,
            "/flat/color/checker/colors",
            "has 3 entries",
        ),
        material("name of a color", r#"{ "flat": { "color": ¤"red" } }"#, "/flat/color", "#rrggbb"),
        material("color below black", r#"{ "flat": { "color": [¤-1, 0, 0] } }"#, "/flat/color/0", "from 0 to 1e6"),
        material("index of refraction of 0.5", r#"{ "surface": { "ior": ¤0.5 } }"#, "/surface/ior", "from 1 to 4"),
        material("roughness of 2", r#"{ "surface": { "roughness": ¤2 } }"#, "/surface/roughness", "from 0 to 1"),
        material(
            "volume without steps",
            r#"{ "volume": { "density": 1, "steps": ¤0 } }"#,
            "/volume/steps",
            "1 to 1024 steps",
        ),
        material("material of no kind", "¤{}", "", "is empty"),
        around(
            "volume painted on a part",
            r#"{ "paint": { "material": ¤{ "volume": { "density": 1 } }, "child": CHILD } }"#,
            "/paint/material",
            "an object of its own",
        ),
    ]
}

fn surroundings() -> Vec<Case> {
    vec![
        scene(
            "sun without a day",
            r#""lights": [{ "sun": ¤{} }]"#,
            "/lights/0/sun",
            "make the background or the `environment` a `day`",
        ),
        scene(
            "light of a transparent sky",
            r#""background": "transparent", "lights": [{ "sky": ¤{} }]"#,
            "/lights/0/sky",
            "`from`",
        ),
        scene(
            "air clearer than clear",
            r#""background": { "day": { "sun": [0, 1, 0], "turbidity": ¤1 } }"#,
            "/background/day/turbidity",
            "from 2 to 10",
        ),
        scene(
            "sun below the horizon",
            r#""background": { "day": { "sun": ¤[0, -1, 0] } }"#,
            "/background/day/sun",
            "y of 0 or more",
        ),
        scene("fog below nothing", r#""fog": { "density": ¤-1 }"#, "/fog/density", "from 0"),
        scene("light that there is not", r#""lights": [{ ¤"area": {} }]"#, "/lights/0/area", "sphere"),
        scene("no steps", r#""march": { "max_steps": ¤0 }"#, "/march/max_steps", "1 to 65536 steps"),
        scene("33 bounces", r#""march": { "max_bounces": ¤33 }"#, "/march/max_bounces", "0 to 32 bounces"),
        changed(
            "field of view of an orthographic picture",
            LOOK_AT,
            r#""look_at": [0, 0, 0], "fov": ¤40, "projection": { "orthographic": { "height": 3 } }"#,
            "/scene/camera/fov",
            "set the height",
        ),
        changed(
            "no frames",
            r#""image""#,
            r#""frames": { "count": ¤0 }, "image""#,
            "/frames/count",
            "1 to 100000 frames",
        ),
    ]
}

/// Track of 10,001 keyframes for the sphere's radius.
fn too_many_keys() -> Case {
    let keys: Vec<String> = (0..10_001).map(|second| format!("[{second}, 1]")).collect();
    let radius = format!(r#""radius": {{ "keys": ¤[{}] }}"#, keys.join(", "));
    changed("10,001 keys", r#""radius": 1"#, &radius, "/scene/objects/0/shape/sphere/radius/keys", "10000 keys")
}

pub(super) fn cases() -> Vec<Case> {
    let tables = [shapes(), forms(), materials(), surroundings(), vec![too_many_keys()]];
    tables.into_iter().flatten().collect()
}
