//! Valid JSON that replaces invalid values, so that the rest can be parsed. One of these fits almost anywhere.

/// A shape.
pub(super) const NODE: &str = r#"{"sphere":{"radius":1}}"#;
/// A list of shapes.
pub(super) const NODES: &str = r#"[{"sphere":{"radius":1}}]"#;
/// An object of the scene.
pub(super) const OBJECT: &str = r#"{"shape":{"sphere":{"radius":1}}}"#;
/// A list of objects.
pub(super) const OBJECTS: &str = r#"[{"shape":{"sphere":{"radius":1}}}]"#;
/// A material.
pub(super) const MATERIAL: &str = r#"{"diffuse":{}}"#;
/// A light.
pub(super) const LIGHT: &str = r#"{"point":{"position":[0,9,0]}}"#;
/// A scene.
const SCENE: &str =
    r#"{"camera":{"position":[0,0,5],"look_at":[0,0,0]},"objects":[{"shape":{"sphere":{"radius":1}}}]}"#;
/// A job.
pub(super) const JOB: &str = r#"{"scene":{"camera":{"position":[0,0,5],"look_at":[0,0,0]},"objects":[{"shape":{"sphere":{"radius":1}}}]},"image":{"width":32,"height":32}}"#;

/// Stand-ins in the order in which they are tried, simplest first.
pub(super) const VALUES: [&str; 33] = [
    "1",
    "2",
    "8",
    "0",
    "0.5",
    "90",
    "true",
    "[1,1,1]",
    "[1,1]",
    "\"#808080\"",
    "\"a\"",
    NODE,
    MATERIAL,
    "[]",
    "{}",
    "null",
    "[[0,1]]",
    "[{}]",
    r##"[[0,"#000000"],[1,"#ffffff"]]"##,
    r##"["#000000","#ffffff"]"##,
    "[[0,0],[1,0],[0,1]]",
    "[[0,0,0],[1,0,0],[0,1,0]]",
    "[[0,0,0],[1,0,0],[1,1,0],[0,1,0]]",
    "[1,1,1,1]",
    NODES,
    r#"{"perlin":{}}"#,
    r#"{"circle":{"radius":1}}"#,
    r#"{"noise":{"perlin":{}}}"#,
    r#"{"sine":{"frequency":1}}"#,
    LIGHT,
    r#"{"position":[0,0,5],"look_at":[0,0,0]}"#,
    r#"{"width":32,"height":32}"#,
    SCENE,
];
