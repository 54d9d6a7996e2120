//! Invalid tracks, cameras, and pictures.

use super::{Case, LOOK_AT, SOUND, changed, written};

pub(super) fn cases() -> Vec<Case> {
    let radius = r#""radius": 1"#;
    vec![
        changed(
            "track with times out of order",
            radius,
            r#""radius": { "keys": [[0, 1], [2, 3], [¤1, 2]] }"#,
            "/scene/objects/0/shape/sphere/radius/keys/2/0",
            "in the order of time",
        ),
        changed(
            "track without keys",
            radius,
            r#""radius": { "keys": ¤[] }"#,
            "/scene/objects/0/shape/sphere/radius/keys",
            "a key or more",
        ),
        changed(
            "key beyond the range of what it moves",
            radius,
            r#""radius": { "keys": [[0, 1], [1, ¤-2]] }"#,
            "/scene/objects/0/shape/sphere/radius/keys/1/1",
            "from 1e-6",
        ),
        changed(
            "ease that there is not",
            radius,
            r#""radius": { "keys": [[0, 1]], "ease": ¤"wobble" }"#,
            "/scene/objects/0/shape/sphere/radius/ease",
            "smooth",
        ),
        changed(
            "track on a count",
            r#""height": 32"#,
            r#""height": 32, "samples": ¤{ "keys": [[0, 1], [1, 4]] }"#,
            "/image/samples",
            "one whole number",
        ),
        changed(
            "track on the frame rate",
            r#""image""#,
            r#""frames": { "count": 2, "fps": ¤{ "keys": [[0, 24]] } }, "image""#,
            "/frames/fps",
            "a number",
        ),
        written(
            "camera that passes through what it looks at",
            &SOUND.replacen(LOOK_AT, r#""look_at": ¤[0, 0, { "keys": [[0, 0], [1, 10]] }]"#, 1).replacen(
                r#""image""#,
                r#""frames": { "count": 24 }, "image""#,
                1,
            ),
            422,
            "/scene/camera/look_at",
            "in frame 12",
        ),
        changed(
            "orthographic picture of no height",
            LOOK_AT,
            r#""look_at": [0, 0, 0], "projection": { "orthographic": { "height": ¤0 } }"#,
            "/scene/camera/projection/orthographic/height",
            "from 1e-6",
        ),
        changed(
            "field of view of a panorama",
            LOOK_AT,
            r#""look_at": [0, 0, 0], "fov": ¤40, "projection": "panorama""#,
            "/scene/camera/fov",
            "remove it",
        ),
        changed(
            "unknown projection",
            LOOK_AT,
            r#""look_at": [0, 0, 0], "projection": ¤"fisheye""#,
            "/scene/camera/projection",
            "panorama",
        ),
        changed(
            "exposure of an EXR",
            r#""height": 32"#,
            r#""height": 32, "format": "exr", "exposure": ¤1"#,
            "/image/exposure",
            "leave exposure out",
        ),
        changed(
            "tone map of an EXR",
            r#""height": 32"#,
            r#""height": 32, "format": "exr", "tone_map": ¤"filmic""#,
            "/image/tone_map",
            "leave tone_map out",
        ),
        changed(
            "exposure out of range",
            r#""height": 32"#,
            r#""height": 32, "exposure": ¤21"#,
            "/image/exposure",
            "20 stops",
        ),
    ]
}
