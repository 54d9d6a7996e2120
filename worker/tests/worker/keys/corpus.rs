//! Jobs that together use every field of the job language, each in a way that affects pixels.

use scene::materials::{Material, Texture};
use scene::nodes::Node;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// A job with this scene; its image and frames have every field.
fn job(scene: &Value) -> Value {
    json!({
        "name": "keys", "priority": 0, "scene": scene, "frames": { "count": 3, "fps": 1, "shutter": 0 },
        "image": { "width": 8, "height": 8, "samples": 2, "seed": 1, "format": "exr", "bits": 8, "precision": "float",
            "layers": ["depth", "normal", "position", "albedo", "object", "steps", "samples"] }
    })
}

fn camera() -> Value {
    json!({ "position": [1.5, 1.4, 3.2], "look_at": [0, 0, 0], "up": [0, 1, 0], "fov": 45 })
}

/// A scene of one object over a floor, with these surroundings.
fn scene(shape: &Value, material: &Value, lights: &Value, background: &Value) -> Value {
    json!({ "camera": camera(), "background": background, "lights": lights, "materials": {},
        "march": { "max_distance": 40.0, "max_steps": 300, "max_bounces": 3 },
        "objects": [
            { "shape": shape, "material": material },
            { "shape": { "plane": { "normal": [0, 1, 0], "offset": -1.5 } }, "material": { "diffuse": {} } }
        ] })
}

fn ball() -> Value {
    json!({ "sphere": { "radius": 1.1 } })
}

fn gray() -> Value {
    json!({ "diffuse": { "kd": [0.6, 0.5, 0.4] } })
}

fn gradient() -> Value {
    json!({ "gradient": { "bottom": [0.9, 0.8, 0.7], "top": [0.2, 0.4, 0.9] } })
}

fn sun() -> Value {
    json!([{ "directional": { "direction": [0.6, 0.7, 0.5], "color": [1, 1, 1], "angle": 4, "shadow": true } }])
}

/// A job without animation, with one material that is used and one that is not.
pub(crate) fn plain() -> Value {
    let mut scene = scene(&ball(), &json!("used"), &sun(), &gradient());
    scene["materials"] = json!({ "used": { "flat": { "color": [0.7, 0.1, 0] } }, "unused": { "normals": {} } });
    job(&scene)
}

/// The job above as a PNG.
pub(crate) fn png() -> Value {
    let mut job = plain();
    job["image"] = json!({ "width": 8, "height": 8, "samples": 2, "seed": 1, "format": "png", "bits": 8,
        "precision": "float", "layers": [], "exposure": 0.5, "tone_map": "none" });
    job
}

/// An example with all optional fields added.
fn written<T: Serialize + DeserializeOwned>(json: &str) -> Value {
    serde_json::to_value(serde_json::from_str::<T>(json).unwrap()).unwrap()
}

/// All of them.
pub(crate) fn jobs() -> Vec<Value> {
    let mut scenes = surroundings();
    let nodes = Node::examples();
    scenes.extend(nodes.iter().map(|node| scene(&written::<Node>(&node.json), &gray(), &sun(), &gradient())));
    let examples = Material::examples();
    scenes.extend(examples.iter().map(|one| scene(&ball(), &written::<Material>(&one.json), &sun(), &gradient())));
    scenes.extend(Texture::examples().iter().map(|texture| {
        let material = json!({ "flat": { "color": written::<Texture>(&texture.json) } });
        scene(&ball(), &material, &sun(), &gradient())
    }));
    scenes.extend(materials().iter().map(|material| scene(&ball(), material, &sun(), &gradient())));
    scenes.extend(shapes().iter().map(|shape| scene(shape, &gray(), &sun(), &gradient())));
    scenes.push(named_shapes());
    scenes.extend(moving());
    let images = [
        plain(),
        png(),
        graded(),
        ungraded(),
        layered(),
        adaptive(),
        denoised(),
        reweighted(),
        with_motion(),
        with_mattes(),
    ];
    images.into_iter().chain(with_light_groups()).chain(scenes.iter().map(job)).collect()
}

/// A PNG whose colors are too bright for it.
fn graded() -> Value {
    let mut job = png();
    job["image"]["exposure"] = json!(1.5);
    job["image"]["tone_map"] = json!("filmic");
    job["image"]["bits"] = json!(16);
    job
}

/// A PNG with fields that matter for EXR only.
fn ungraded() -> Value {
    let mut job = png();
    job["image"]["exposure"] = json!(0);
    job
}

/// An EXR with some of the layers, and the name of an object.
fn layered() -> Value {
    let mut job = plain();
    job["image"]["layers"] = json!(["depth", "object"]);
    job["image"]["region"] = json!([1, 2, 5, 4]);
    job["scene"]["objects"][0]["name"] = json!("ball");
    job
}

/// Four blocks of pixels, each with as many samples as its noise needs.
fn adaptive() -> Value {
    let lights = json!([{ "sphere": { "position": [0.2, 2, 1], "radius": 0.5, "color": [4, 4, 4] } }]);
    let mut job = job(&scene(&ball(), &gray(), &lights, &gradient()));
    for (key, value) in [("width", json!(16)), ("height", json!(16)), ("layers", json!(["samples"]))] {
        job["image"][key] = value;
    }
    job["image"]["denoise"] = json!(false);
    job["image"]["samples"] = json!({ "adaptive": { "min": 8, "max": 32, "error": 0.02 } });
    job
}

/// A denoised picture with the colors before the denoiser.
fn denoised() -> Value {
    let mut job = adaptive();
    job["image"]["samples"] = json!(4);
    job["image"]["denoise"] = json!(true);
    job["image"]["layers"] = json!(["noisy"]);
    job
}

/// A picture of paths whose fireflies are reweighted: few samples meet a small lamp before the ball.
fn reweighted() -> Value {
    let lamp =
        json!({ "sphere": { "position": [0.8, 0.7, 1.5], "radius": 0.04, "color": [4, 4, 4], "visible": true } });
    let mut job = adaptive();
    job["scene"]["lights"] = json!([lamp]);
    job["scene"]["integrator"] = json!({ "path": { "max_bounces": 2 } });
    job["image"]["samples"] = json!(16);
    job["image"]["reweight_fireflies"] = json!(true);
    job
}

/// A picture with the way of each point until the next frame.
fn with_motion() -> Value {
    let shape = json!({ "translate": { "by": [{ "keys": [[0, 0], [2, 0.5]] }, 0.1, 0], "child": ball() } });
    let mut job = job(&scene(&shape, &gray(), &sun(), &gradient()));
    job["image"]["layers"] = json!(["motion"]);
    job
}

/// A picture with ids of objects and materials; some have names.
fn with_mattes() -> Value {
    let mut job = plain();
    job["image"]["layers"] = json!(["crypto_object", "crypto_material"]);
    job["scene"]["objects"][0]["name"] = json!("ball");
    job
}

/// Pictures with the light of some groups, to which each kind of light and an object belong.
fn with_light_groups() -> [Value; 2] {
    let day = json!({ "day": { "sun": [0.5, 0.4, 0.3] } });
    let lights = json!([
        { "directional": { "direction": [0.6, 0.7, 0.5], "group": "key" } },
        { "point": { "position": [1, 2, 2], "color": [4, 4, 4], "group": "used" } },
        { "point": { "position": [-1, 2, 2], "color": [4, 3, 4], "group": "key" } },
        { "spot": { "position": [1, 2, 2], "direction": [-1, -2, -2], "angle": 60, "color": [4, 4, 4], "group": "key" } },
        { "sphere": { "position": [2, 3, 1.3], "radius": 0.3, "color": [4, 4, 4], "group": "key" } },
        { "rectangle": { "position": [0.2, 3, 2], "direction": [-0.2, -3, -2], "width": 0.9, "height": 0.6, "color": [4, 4, 4], "group": "key" } },
        { "disc": { "position": [1, 2, 2], "direction": [-1, -2, -2], "radius": 0.4, "color": [4, 4, 4], "group": "key" } },
        { "sun": { "group": "key" } },
        { "sky": { "group": "key" } }
    ]);
    let with = |groups: Value| {
        let mut job = job(&scene(&ball(), &json!({ "flat": { "color": [0.3, 0.2, 0.1] } }), &lights, &day));
        job["scene"]["integrator"] = json!({ "path": { "max_bounces": 2 } });
        job["scene"]["objects"][0]["light_group"] = json!("key");
        job["image"]["samples"] = json!(32);
        job["image"]["light_groups"] = groups;
        job
    };
    [with(json!(["key", "used"])), with(json!(["key"]))]
}

/// Cameras, backgrounds, lights, fog and occlusion.
fn surroundings() -> Vec<Value> {
    let day = json!({ "day": { "sun": [0.5, 0.4, 0.3], "turbidity": 3, "ground": [0.3, 0.2, 0.1], "strength": 1 } });
    let sky = |shadow: bool, from: Value| json!([{ "sky": { "strength": 1, "from": from, "shadow": shadow } }]);
    let mut scenes: Vec<Value> = [
        json!([]),
        json!([{ "point": { "position": [1, 2, 2], "color": [4, 4, 4], "shadow": true } }]),
        json!([{ "spot": { "position": [1, 2, 2], "direction": [-1, -2, -2], "angle": 60, "softness": 0.3,
            "color": [4, 4, 4], "shadow": true } }]),
        json!([{ "sphere": { "position": [0.2, 0.3, 1.3], "radius": 0.3, "color": [4, 4, 4], "shadow": true,
            "visible": false } }]),
        json!([{ "rectangle": { "position": [0.2, 0.8, 1.6], "direction": [-0.2, -0.6, -0.8], "up": [0, 1, 0.1],
            "width": 0.9, "height": 0.6, "color": [4, 4, 4], "shadow": true, "visible": true } }]),
        json!([{ "disc": { "position": [1, 2, 2], "direction": [-1, -2, -2], "radius": 0.4, "color": [4, 4, 4],
            "shadow": true } }]),
        json!([{ "disc": { "position": [0.2, 0.6, 1.7], "direction": [0.3, -0.2, 0.8], "radius": 0.4,
            "color": [4, 4, 4], "shadow": true, "visible": true } }]),
        sky(true, gradient()),
        sky(false, gradient()),
        sky(false, json!({ "color": [0.4, 0.5, 0.9] })),
    ]
    .iter()
    .map(|lights| scene(&ball(), &gray(), lights, &gradient()))
    .collect();
    let sun_of_day = json!([{ "sun": { "strength": 1, "angle": 5, "shadow": true } }, { "sky": { "shadow": false } }]);
    scenes.push(scene(&ball(), &gray(), &sun_of_day, &day));
    for background in [json!({ "color": [0.2, 0.3, 0.4] }), json!("transparent"), json!({ "color": "#336699" })] {
        scenes.push(scene(&ball(), &gray(), &sun(), &background));
    }
    let mut add = |key: &str, value: Value| {
        let mut scene = scene(&ball(), &gray(), &sky(false, Value::Null), &gradient());
        scene[key] = value;
        scenes.push(scene);
    };
    add("fog", json!({ "density": 0.2, "falloff": 0.3, "color": [0.5, 0.5, 0.6] }));
    add("fog", json!({ "density": 0.2, "falloff": 0, "color": null }));
    add("ambient_occlusion", json!({ "distance": 1.5, "strength": 0.8 }));
    let with = |more: &[(&str, Value)]| {
        let mut camera = camera();
        for (key, value) in more {
            camera[key] = value.clone();
        }
        camera
    };
    add("camera", with(&[("projection", json!("perspective"))]));
    add("camera", with(&[("fov", Value::Null), ("projection", json!({ "orthographic": { "height": 3 } }))]));
    add("camera", with(&[("fov", Value::Null), ("projection", json!("panorama"))]));
    add("camera", with(&[("turntable", json!({ "turns": 0.7 }))]));
    add("march", json!({ "max_distance": 40.0, "max_steps": 6, "max_bounces": 3 }));
    add("integrator", json!("direct"));
    add("integrator", json!({ "path": { "max_bounces": 2 } }));
    for lens in lenses() {
        add("camera", with(&[("lens", lens)]));
    }
    scenes.extend(seen_by_some());
    scenes.push(in_the_shadow_of_glass());
    scenes
}

/// A floor that is lit through glass.
fn in_the_shadow_of_glass() -> Value {
    let glass = json!({ "surface": { "base_color": [1, 1, 1], "transmission": 1, "ior": 1.3 } });
    let light = json!([{ "point": { "position": [0.2, 5, 0.3], "color": [20, 20, 20] } }]);
    let mut scene = scene(&ball(), &glass, &light, &json!({ "color": [0.1, 0.1, 0.1] }));
    scene["integrator"] = json!({ "path": { "max_bounces": 2, "straight_shadows": true } });
    let floor = json!({ "shape": { "plane": { "normal": [0, 1, 0], "offset": -1 } }, "material": gray() });
    scene["objects"].as_array_mut().expect("a list").push(floor);
    scene
}

/// Lenses, focused before the object and behind it.
fn lenses() -> [Value; 3] {
    [
        json!({ "aperture": 0.4, "focus": 2, "blades": 6, "turn": 15 }),
        json!({ "f_stop": 2.8, "focal_length": 1.1, "focus": [0.3, 0.2, 1.2] }),
        json!({ "aperture": 0.4, "focus": { "keys": [[0, 3], [2, 8]], "ease": "linear" } }),
    ]
}

/// An environment apart from the background, objects that some rays do not see, and a shadow catcher.
fn seen_by_some() -> Vec<Value> {
    let at = |by: [f64; 3], shape: Value| json!({ "translate": { "by": by, "child": shape } });
    let floor = || at([0.0, -0.8, 0.0], json!({ "box": { "size": [4, 0.2, 4] } }));
    let part = || at([0.5, 0.6, 0.6], json!({ "sphere": { "radius": 0.5 } }));
    let mirror = || json!({ "surface": { "base_color": [0.9, 0.9, 0.9], "metallic": 1, "roughness": 0.1 } });
    let catcher = json!({ "shadow_catcher": { "opacity": 0.8 } });
    let seen = json!({ "camera": true, "shadow": true, "reflection": true });
    let mut around =
        scene(&ball(), &mirror(), &json!([{ "sky": { "strength": 1, "shadow": false } }]), &json!("transparent"));
    around["environment"] = gradient();
    let mut day = scene(
        &floor(),
        &gray(),
        &json!([{ "sun": { "strength": 1, "angle": 5, "shadow": true } }]),
        &json!("transparent"),
    );
    day["environment"] =
        json!({ "day": { "sun": [0.5, 0.4, 0.3], "turbidity": 3, "ground": [0.3, 0.2, 0.1], "strength": 1 } });
    let mut flags = scene(&floor(), &mirror(), &sun(), &gradient());
    flags["objects"].as_array_mut().unwrap().push(json!({ "material": gray(), "shape": part(), "visible": seen }));
    let mut reflected = scene(&floor(), &mirror(), &sun(), &gradient());
    let beside = at([0.3, -0.2, 0.2], json!({ "sphere": { "radius": 0.5 } }));
    reflected["objects"].as_array_mut().unwrap().push(json!({ "material": gray(), "shape": beside, "visible": seen }));
    let mut caught = scene(&floor(), &catcher, &sun(), &gradient());
    caught["objects"].as_array_mut().unwrap().push(json!({ "material": gray(), "shape": part() }));
    vec![around, day, flags, reflected, caught, group(), flight()]
}

/// A group with everything that moves with one.
fn group() -> Value {
    let inner =
        json!({ "by": [0.5, 0.4, 0], "objects": [{ "material": gray(), "shape": { "sphere": { "radius": 0.4 } } }] });
    let mut scene = scene(&ball(), &gray(), &sun(), &gradient());
    scene["groups"] = json!([{
        "by": [0.2, 0.1, 0], "degrees": 30, "axis": [0, 1, 0.2], "about": [0.1, 0, 0.3], "camera": true,
        "objects": [{ "material": gray(), "shape": { "box": { "size": [0.5, 0.5, 0.5] } } }],
        "lights": [{ "point": { "position": [1, 2, 2], "color": [4, 4, 4], "shadow": true } }],
        "groups": [inner]
    }]);
    scene
}

/// A camera on a path that looks ahead. In the rendered frame it is between two of its points.
fn flight() -> Value {
    let mut scene = scene(&ball(), &gray(), &sun(), &gradient());
    let path = json!({ "through": [[-1, 1, 4], [1, 1.4, 5], [2, 1, 2]], "closed": true,
        "keys": [[0, 0], [0.8, 0.5], [1.3, 0.9]], "ease": "smooth", "loop": "ping_pong" });
    scene["camera"] = json!({ "position": { "path": path }, "look_at": { "ahead": 0.4, "bank": 0.3 }, "fov": 60,
        "up": [0, 1, 0] });
    let turning = json!({ "through": [[1, 1, 0], [0, 1, 1], [-1, 1, 0]], "keys": [[0, 0.1], [2, 0.9]] });
    scene["lights"][0]["directional"]["direction"] = json!({ "path": turning });
    scene
}

/// Materials with textures as parameters, and numbers that textures vary.
fn materials() -> Vec<Value> {
    let texture = json!({ "checker": { "cell": 0.3, "colors": [[0.1, 0.2, 0.3], [0.9, 0.8, 0.2]] } });
    let varied = |low: f64, high: f64| json!({ "low": low, "high": high, "by": texture });
    vec![
        json!({ "surface": { "base_color": texture, "roughness": varied(0.1, 0.9) } }),
        json!({ "surface": { "base_color": [0.5, 0.5, 0.5], "roughness": 0.3, "transmission": 0.8, "ior": varied(1.2, 1.8) } }),
        json!({ "surface": { "metallic": 0.5, "clearcoat": 0.7, "clearcoat_roughness": 0.2, "emission": [0.1, 0, 0] } }),
        json!({ "diffuse": { "kd": "#8090a0", "ks": [0.8, 0.8, 0.8], "shininess": varied(5.0, 80.0), "ambient": [0.2, 0.2, 0.2] } }),
        json!({ "diffuse": { "ka": [0.2, 0.1, 0.1], "kd": [0.5, 0.5, 0.5] } }),
    ]
}

/// Shapes with parameters that none of their examples has.
fn shapes() -> Vec<Value> {
    let bumps =
        |by: Value| json!({ "displace": { "by": by, "amplitude": 0.2, "child": { "sphere": { "radius": 1 } } } });
    let octaves = |kind: &str| json!({ "noise": { kind: { "octaves": 3, "gain": 0.5, "lacunarity": 2.1 } } });
    vec![
        // In the rendered frame, each interpolation between keyframes has a different value.
        json!({ "sphere": { "radius": { "keys": [[0, 0.5], [3, 1.5]], "ease": "smooth" } } }),
        bumps(json!({ "sine": { "frequency": 7 } })),
        bumps(octaves("cellular")),
        bumps(octaves("gardner")),
        json!({ "copies": { "child": { "box": { "size": [0.5, 0.8, 0.6] } }, "at": {
            "by": [[-0.7, 0, 0], [0.7, 0.2, 0.3]], "degrees": [[0, 20, 10], [40, 0, 0]], "scale": [1, 1.3],
            "material": [{ "diffuse": { "kd": [0.8, 0.2, 0.1] } }, { "flat": { "color": [0.1, 0.5, 0.2] } }]
        } } }),
        json!({ "copies": { "child": { "box": { "size": [0.5, 0.8, 0.6] } }, "at": {
            "count": 3, "by": [{ "expr": "0.8 * i - 0.5" }, 0.2, 0.1], "degrees": [20, 40, 10], "scale": 1.3,
            "material": { "diffuse": { "kd": [0.8, 0.2, 0.1] } }
        } } }),
    ]
}

/// Scenes with named numbers, formulas, tracks of points and colors, and color temperatures.
fn moving() -> Vec<Value> {
    let at = |x: f64, radius: Value| json!({ "translate": { "by": [x, 0, 0], "child": { "sphere": { "radius": radius } } } });
    let of = |name: &str| json!({ "expr": format!("{name} * 0.5") });
    let balls =
        json!({ "union": { "of": [at(-1.2, of("a")), at(-0.4, of("b")), at(0.4, of("c")), at(1.2, of("d"))] } });
    let mut numbers = scene(&balls, &gray(), &sun(), &gradient());
    numbers["numbers"] = json!({ "a": 0.8, "b": "a * 1.2", "c": { "expr": "a - 0.2" },
        "d": { "keys": [[0, 0.5], [0.7, 1.5]], "ease": [0.3, 0, 0.7, 1], "loop": "repeat" } });
    let own = json!({ "use": { "shape": "used", "with": { "r": 0.7 } } });
    let mut with = scene(&own, &gray(), &sun(), &gradient());
    let shape = |edge: f64| json!({ "box": { "size": [1, edge, { "expr": "r" }] } });
    with["shapes"] = json!({ "used": shape(0.8), "other": shape(1.4) });
    with["numbers"] = json!({ "r": 1.1 });
    // The first way back is in the rendered frame, at one second.
    let eased = |from: Value, to: Value| {
        let keys = json!([[0, from], [0.3, to, "smooth"], [0.8, from]]);
        json!({ "keys": keys, "ease": "linear", "loop": "ping_pong" })
    };
    let shifted = json!({ "translate": { "by": eased(json!([0, 0, 0]), json!([1, 0.5, 0])), "child": ball() } });
    let rotated =
        |degrees: Value| json!({ "rotate": { "degrees": degrees, "child": { "box": { "size": [1, 1.5, 0.7] } } } });
    let rotated = rotated(eased(json!([0, 20, 10]), json!([40, 0, 0])));
    let light = |color: Value| json!([{ "point": { "position": [1, 2, 2], "color": color, "shadow": true } }]);
    let colors = [
        json!({ "kelvin": 3000 }),
        eased(json!([1, 0.2, 0.1]), json!([0.1, 0.9, 2])),
        eased(json!("#ff2010"), json!("#1020ff")),
        eased(json!({ "kelvin": 2000 }), json!({ "kelvin": 12000 })),
    ];
    let lit = colors.map(|color| scene(&ball(), &gray(), &light(color), &gradient()));
    [numbers, with, scene(&shifted, &gray(), &sun(), &gradient()), scene(&rotated, &gray(), &sun(), &gradient())]
        .into_iter()
        .chain(lit)
        .collect()
}

/// A scene with named shapes, one of them in use.
fn named_shapes() -> Value {
    let mut scene = scene(&json!({ "use": "used" }), &gray(), &sun(), &gradient());
    scene["shapes"] = json!({ "used": ball(), "other": { "box": { "size": [1, 1.5, 1] } } });
    scene
}
