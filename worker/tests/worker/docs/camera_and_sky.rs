//! Generates the page of projections, backgrounds and effects.

use scene::backgrounds::Background;
use scene::camera::{Lens, Projection};
use scene::{Job, effects};

use super::picture::stage;
use super::schema::{kind_section, part};
use super::{Page, Picture, file};

const HEAD: &str = "# Camera and sky

How the camera projects space onto the picture, the background behind all objects, and fog and ambient occlusion. This page is made
from the code: `SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs`.
";

const PROJECTIONS: &str = "
# Projections

The `projection` of a camera. Each picture shows the same rows of columns from the same place.
";

const LENSES: &str = "
# Lens

The `lens` of a camera. The pictures show a ball, columns and lamps far behind them. This is what a pinhole sees:

![without a lens](pictures/lenses/none.webp)
";

const BACKGROUNDS: &str = "
# Backgrounds

The `background` of a scene. Each picture shows it behind a matte ball and reflected by one of metal. A background with a sun is
lit by the lights `sun` and `sky`, the others by one directional light.
";

const EFFECTS: &str = "
# Effects

Keys of a scene that may be absent. This is the scene of the pictures without any of them:

![without effects](pictures/effects/none.webp)
";

/// Two rows of columns on a checkered floor, with a ball between them.
const COLUMNS: &str = r##"
    { "shape": { "repeat": { "cell": [2.4, null, 2.4], "count": [2, null, 10],
        "child": { "cylinder": { "radius": 0.32, "height": 2.4 } } } },
      "material": { "diffuse": { "kd": "#c9b08a" } } },
    { "shape": { "translate": { "by": [0.1, -0.7, 2.4], "child": { "sphere": { "radius": 0.5 } } } },
      "material": { "diffuse": { "kd": "#b5432f", "ks": [0.2, 0.2, 0.2], "shininess": 30 } } },
    { "shape": { "plane": { "normal": [0, 1, 0], "offset": -1.2 } },
      "material": { "diffuse": { "kd": { "checker": { "cell": 1.2, "colors": ["#707a86", "#a9b1ba"] } } } } }"##;

/// Small lamps over the far columns.
const LAMPS: &str = r#"
    { "shape": { "translate": { "by": [0, 1.2, -6], "child": { "repeat": { "cell": [1.2, 0.9, null], "count": [9, 3, null],
        "child": { "sphere": { "radius": 0.1 } } } } } },
      "material": { "flat": { "color": [9, 6, 2.5] } } }"#;

/// A matte ball and one of metal in front of a background.
const BALLS: &str = r##"
    { "shape": { "translate": { "by": [-0.85, 0, 0], "child": { "sphere": { "radius": 0.75 } } } },
      "material": { "diffuse": { "kd": "#c8c4bc" } } },
    { "shape": { "translate": { "by": [0.85, 0, 0], "child": { "sphere": { "radius": 0.75 } } } },
      "material": { "surface": { "base_color": [0.95, 0.78, 0.5], "metallic": 1, "roughness": 0.08 } } }"##;

fn columns(projection: &str) -> Job {
    let projection_of: Projection = serde_json::from_str(projection).expect("an example is a projection");
    let scene = format!(
        r#""camera": {{ "position": [0.1, 0.7, 7.2], "look_at": [-0.05, -0.35, 0], "projection": {projection} }},
        "lights": [{{ "directional": {{ "direction": [-0.5, 0.8, 0.6], "color": [0.85, 0.82, 0.78] }} }}],
        "objects": [{COLUMNS}]"#
    );
    let job = stage(&scene, [240, 180]);
    if projection_of.warning(job.image.film()).is_some() { stage(&scene, [320, 160]) } else { job }
}

/// The ball and the columns behind it, with rows of lamps.
fn through(lens: &str) -> Job {
    let scene = format!(
        r##""camera": {{ "position": [0.1, 0.1, 6.4], "look_at": [0.1, -0.25, 0], "fov": 34{lens} }},
        "background": {{ "gradient": {{ "bottom": "#20242c", "top": "#0c0f16" }} }},
        "lights": [{{ "directional": {{ "direction": [-0.5, 0.8, 0.6], "color": [0.3, 0.29, 0.28] }} }}],
        "objects": [{COLUMNS}, {LAMPS}]"##
    );
    let mut job = stage(&scene, [240, 180]);
    // Few of the rays of a blurred lamp meet it.
    job.image.samples = 512.into();
    job
}

fn before(background: &str) -> Job {
    let shown: Background = serde_json::from_str(background).expect("an example is a background");
    let lights = if shown.day().is_some() {
        r#"{ "sun": {} }, { "sky": {} }"#
    } else {
        r#"{ "directional": { "direction": [-0.5, 0.8, 0.6], "color": [0.8, 0.8, 0.8] } }"#
    };
    let scene = format!(
        r#""camera": {{ "position": [0, 0.35, 5.2], "look_at": [0, 0.28, 0] }}, "background": {background},
        "lights": [{lights}], "objects": [{BALLS}]"#
    );
    stage(&scene, [240, 180])
}

fn with(effect: &str) -> Job {
    let keys = effect.trim_start_matches('{').trim_end_matches('}');
    let comma = if keys.trim().is_empty() { "" } else { "," };
    let scene = format!(
        r##"{keys}{comma} "camera": {{ "position": [0.1, 0.5, 7.2], "look_at": [-0.05, -0.4, 0] }},
        "background": {{ "gradient": {{ "bottom": "#d7dee6", "top": "#5f86b8" }} }},
        "lights": [{{ "directional": {{ "direction": [-0.5, 0.8, 0.6], "color": [0.4, 0.38, 0.34] }} }},
                   {{ "sky": {{ "shadow": false }} }}],
        "objects": [{COLUMNS}]"##
    );
    stage(&scene, [240, 180])
}

pub(crate) fn page() -> Page {
    let schema = scene::schema();
    let mut page = Page { name: "camera-and-sky.md", text: HEAD.to_owned(), pictures: Vec::new() };
    page.text += &part(&schema, "Camera");
    page.text += &part(&schema, "Turntable");
    let none = Picture::of_first_frame("pictures/effects/none.webp".to_owned(), with(""));
    let pinhole = Picture::of_first_frame("pictures/lenses/none.webp".to_owned(), through(""));
    let behind = |lens: &str| through(&format!(r#", "lens": {lens}"#));
    let families = [
        (PROJECTIONS, "projections", "Projection", Projection::examples(), columns as fn(&str) -> Job),
        (LENSES, "lenses", "Lens", Lens::examples(), behind),
        (BACKGROUNDS, "backgrounds", "Background", Background::examples(), before),
        (EFFECTS, "effects", "Scene", effects::examples(), with),
    ];
    for (heading, folder, definition, examples, job) in families {
        page.text += heading;
        for example in examples {
            let file = file(folder, &example.name, example.index);
            page.text += &kind_section(&schema, definition, &example, &file);
            page.pictures.push(Picture::of_first_frame(file, job(&example.json)));
        }
    }
    page.pictures.extend([none, pinhole]);
    page
}
