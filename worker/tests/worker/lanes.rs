//! Every vector width is bit-identical to the scalar reference: for each node, material, texture, light,
//! background, projection and effect, and for complete pixels of scenes that use everything. Nothing is listed
//! by name here.

use proto::Rect;
use scene::backgrounds::Background;
use scene::camera::{Lens, Projection};
use scene::integrator::Ranks;
use scene::kinds::Example;
use scene::lights::Light;
use scene::materials::{Material, Texture};
use scene::nodes::Node;
use scene::transport::{PathSettings, Transport};
use scene::{ImageSpec, Integrator, Job, Layer, effects};
use serde_json::{Value, json};
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TileRequest};

use crate::skip::skip;

/// Each level that this CPU has; prints a `skipped:` line for the others.
pub(crate) fn levels() -> impl Iterator<Item = Simd> {
    Simd::LEVELS.into_iter().filter(|level| {
        let available = level.is_available();
        if !available {
            skip(level.name(), format_args!("this CPU has no {level}"));
        }
        available
    })
}

/// The job of a gray object over a floor.
fn job(node: &str) -> Job {
    let gray = r#"{ "diffuse": { "ks": [0.4, 0.4, 0.4] } }"#;
    job_of(&format!(r#"{{ "shape": {node}, "material": {gray} }}"#))
}

/// The job of an object over a floor.
fn job_of(object: &str) -> Job {
    let text = format!(
        r#"{{ "scene": {{ "camera": {{ "position": [1.5, 1.4, 3.2], "look_at": [0, 0, 0] }},
            "background": "transparent",
            "lights": [{{ "directional": {{ "direction": [0.6, 0.7, 0.5] }} }},
                       {{ "point": {{ "position": [-2, 2, 2], "color": [3, 2, 1] }} }}],
            "objects": [{object},
                        {{ "shape": {{ "plane": {{ "normal": [0, 1, 0], "offset": -1.5 }} }},
                           "material": {{ "normals": {{}} }} }}] }},
          "image": {{ "width": 37, "height": 29, "samples": 3, "format": "exr", "precision": "float",
                     "layers": ["depth", "normal", "position", "albedo", "object", "steps"] }} }}"#
    );
    scene::parse(text.as_bytes()).unwrap()
}

/// The pixel computed with plain `f32`, channel by channel.
fn reference(program: &Integrator<'_>, image: &ImageSpec, x: u32, y: u32) -> Vec<f32> {
    let seen = program.pixel(x as f32, y as f32);
    let met = program.layer_values(x as f32, y as f32);
    let coverage = program.coverage(x as f32, y as f32);
    let ranks = |ranks: Option<Ranks<f32>>| {
        let Ranks(ranks) = ranks.expect("the picture has this layer");
        ranks.into_iter().flat_map(|rank| [rank.id, rank.coverage])
    };
    let mut channels = vec![seen.color.x, seen.color.y, seen.color.z, seen.alpha];
    for layer in &image.layers {
        match layer {
            Layer::Depth => channels.push(met.depth),
            Layer::Normal => channels.extend(<[f32; 3]>::from(met.normal)),
            Layer::Position => channels.extend(<[f32; 3]>::from(met.position)),
            Layer::Albedo => channels.extend(<[f32; 3]>::from(met.albedo)),
            Layer::Object => channels.push(met.object),
            Layer::Steps => channels.push(met.steps),
            Layer::Samples => channels.push(met.samples),
            Layer::Noisy => channels.extend([0.0; 3]),
            Layer::CryptoObject => channels.extend(ranks(coverage.objects)),
            Layer::CryptoMaterial => channels.extend(ranks(coverage.materials)),
            Layer::Motion => channels.extend(<[f32; 2]>::from(met.motion)),
        }
    }
    channels
}

/// Renders a job at every width and compares it with the reference.
fn compare(name: &str, job: &Job) {
    let at_frame = job.at(0).unwrap();
    let program = Integrator::new(&at_frame);
    let rect = Rect::full(job.image.width, job.image.height);
    let places = (0..rect.height).flat_map(|y| (0..rect.width).map(move |x| (x, y)));
    let pixels: Vec<_> = places.map(|(x, y)| (x, y, reference(&program, &job.image, x, y))).collect();
    for simd in levels() {
        let renderer = CpuRenderer::new(Some(1), simd).unwrap();
        let run = TileRequest { job, frame: 0, rect };
        let rendered = renderer.render(&run, &CancelFlag::new(), &|_| ()).unwrap();
        for (x, y, wanted) in &pixels {
            for (plane, want) in rendered.planes.iter().zip(wanted) {
                let got = plane[(y * rect.width + x) as usize];
                assert!(!got.is_nan(), "{name} by {simd} at ({x}, {y}) is NaN");
                assert_eq!(got.to_bits(), (want + 0.0).to_bits(), "{name} by {simd} at ({x}, {y}): {got} for {want}");
            }
        }
    }
}

/// Compares a job, and the same with path tracing.
fn compare_with_paths(name: &str, job: &Job) {
    compare(name, job);
    let mut paths = job.clone();
    (paths.image.width, paths.image.height) = (19, 13);
    for straight_shadows in [false, true] {
        paths.scene.integrator = Transport::Path(PathSettings { max_bounces: 3, straight_shadows });
        compare(&format!("{name} with paths, straight shadows: {straight_shadows}"), &paths);
    }
}

#[test]
fn every_width_gives_the_reference_bits_for_every_node() {
    for example in Node::examples() {
        let mut job = job(&example.json);
        (job.image.width, job.image.height) = (13, 11);
        compare(example.kind, &job);
    }
}

#[test]
#[ignore = "long: eight times as many pixels; 40 s"]
fn every_width_gives_the_reference_bits_for_every_node_at_many_pixels() {
    for example in Node::examples() {
        compare(example.kind, &job(&example.json));
    }
}

/// A material on a rotated ball blended smoothly with a box.
fn melting(material: &str) -> String {
    format!(
        r#"{{ "union": {{ "smooth": 0.4, "of": [
             {{ "rotate": {{ "degrees": [20, 30, 10],
                "child": {{ "paint": {{ "material": {material}, "child": {{ "sphere": {{ "radius": 1 }} }} }} }} }} }},
             {{ "translate": {{ "by": [0.9, -0.5, 0], "child": {{ "box": {{ "size": [1, 1, 1] }} }} }} }} ] }} }}"#
    )
}

#[test]
fn every_width_gives_the_reference_bits_for_every_material() {
    for example in Material::examples() {
        let material: Material = serde_json::from_str(&example.json).unwrap();
        // A medium belongs to a complete object.
        let job = if material.is_medium() {
            job_of(&format!(r#"{{ "material": {}, "shape": {{ "sphere": {{ "radius": 1 }} }} }}"#, example.json))
        } else {
            job(&melting(&example.json))
        };
        compare_with_paths(example.kind, &job);
    }
}

#[test]
fn every_width_gives_the_reference_bits_for_every_texture() {
    for example in Texture::examples() {
        let material = format!(r#"{{ "diffuse": {{ "kd": {} }} }}"#, example.json);
        compare(example.kind, &job(&melting(&material)));
    }
}

/// A ball on a floor, with these members of the scene.
fn scene_with(keys: &Value) -> Value {
    let mut scene = json!({ "camera": { "position": [1.5, 1.4, 3.2], "look_at": [0, 0.6, 0] }, "objects": [
        { "shape": { "sphere": { "radius": 1 } }, "material": { "diffuse": { "ks": [0.4, 0.4, 0.4] } } },
        { "shape": { "plane": { "normal": [0, 1, 0], "offset": -1.5 } }, "material": { "diffuse": {} } } ] });
    for (key, value) in keys.as_object().expect("members of a scene") {
        scene[key] = value.clone();
    }
    scene
}

/// Compares the scene with each example in place.
fn compare_each(examples: &[Example], keys: impl Fn(Value) -> Value) {
    for example in examples {
        let value = serde_json::from_str(&example.json).unwrap();
        let image = json!({ "width": 37, "height": 19, "samples": 2, "format": "exr", "precision": "float",
            "layers": ["depth", "normal", "position", "albedo", "object", "steps"] });
        let text = json!({ "scene": scene_with(&keys(value)), "image": image }).to_string();
        compare_with_paths(example.kind, &scene::parse(text.as_bytes()).unwrap());
    }
}

#[test]
fn every_width_gives_the_reference_bits_for_every_light() {
    compare_each(
        &Light::examples(),
        |light| json!({ "lights": [light], "background": { "day": { "sun": [0.6, 0.5, 0.4] } } }),
    );
}

#[test]
fn every_width_gives_the_reference_bits_for_objects_that_shine() {
    let shines = json!({ "material": { "surface": { "base_color": [0.2, 0.3, 0.4], "emission": [3, 2, 1] } },
        "shape": { "translate": { "by": [1.6, 0.4, 0.3], "child": { "box": { "size": [0.4, 1, 0.3] } } } } });
    let mut objects = scene_with(&json!({}))["objects"].clone();
    objects.as_array_mut().expect("objects").push(shines);
    let lights = json!([{ "sphere": { "position": [-1, 2, 1], "radius": 0.3, "visible": true } },
        { "rectangle": { "position": [0, 2, -1], "direction": [0.2, -1, 0.3], "width": 1, "height": 0.5, "visible": true } }]);
    let scene = scene_with(&json!({ "objects": objects, "lights": lights }));
    let image = json!({ "width": 37, "height": 19, "samples": 3 });
    let job = scene::parse(json!({ "scene": scene, "image": image }).to_string().as_bytes()).unwrap();
    compare_with_paths("objects that shine", &job);
}

#[test]
fn every_width_gives_the_reference_bits_for_every_background() {
    compare_each(&Background::examples(), |background| json!({ "background": background }));
}

#[test]
fn every_width_gives_the_reference_bits_for_every_projection() {
    compare_each(
        &Projection::examples(),
        |projection| json!({ "camera": { "position": [1.5, 1.4, 3.2], "look_at": [0, 0.6, 0], "projection": projection } }),
    );
}

#[test]
fn every_width_gives_the_reference_bits_for_every_lens() {
    let camera = |lens: &Value, projection: &Value| {
        json!({ "camera": { "position": [1.5, 1.4, 3.2], "look_at": [0, 0.6, 0],
        "projection": projection, "lens": lens } })
    };
    for projection in [json!("perspective"), json!({ "orthographic": { "height": 3 } })] {
        compare_each(&Lens::examples(), |lens| camera(&lens, &projection));
    }
    // A mirror takes the longer path, and a single sample has its own.
    let mut text = json!({ "scene": scene_with(&camera(&json!({ "aperture": 0.5, "focus": 3 }), &json!("perspective"))),
        "image": { "width": 37, "height": 19, "samples": 1, "format": "exr", "precision": "float", "layers": ["depth"] } });
    compare("one sample", &scene::parse(text.to_string().as_bytes()).unwrap());
    text["scene"]["objects"][0]["material"] = json!({ "surface": { "metallic": 1, "roughness": 0.1 } });
    text["image"]["samples"] = json!(5);
    compare("mirror", &scene::parse(text.to_string().as_bytes()).unwrap());
}

#[test]
fn every_width_gives_the_reference_bits_for_every_effect() {
    compare_each(&effects::examples(), |keys| keys);
}

#[test]
fn a_tile_equals_its_part_of_the_picture() {
    let example = Node::examples().swap_remove(0);
    tiles_equal_the_whole(&job(&example.json));
}

#[test]
fn a_tile_of_a_lens_equals_its_part_of_the_picture() {
    let mut job = job(&Node::examples().swap_remove(0).json);
    job.scene.camera.lens = Some(serde_json::from_value(json!({ "aperture": 0.6, "focus": 2, "blades": 5 })).unwrap());
    tiles_equal_the_whole(&job);
}

/// Compares two tiles with the whole picture, with those at its right and at its bottom.
fn tiles_equal_the_whole(job: &Job) {
    let renderer = CpuRenderer::new(Some(2), Simd::Auto).unwrap();
    let render = |rect| renderer.render(&TileRequest { job, frame: 0, rect }, &CancelFlag::new(), &|_| ()).unwrap();
    let whole = render(Rect::full(job.image.width, job.image.height));
    for part in [Rect { x: 32, y: 0, width: 5, height: 29 }, Rect { x: 0, y: 19, width: 37, height: 3 }] {
        let tile = render(part);
        for (plane, want) in tile.planes.iter().zip(&whole.planes) {
            for (index, got) in plane.iter().enumerate() {
                let (x, y) =
                    (part.x as usize + index % part.width as usize, part.y as usize + index / part.width as usize);
                assert_eq!(got.to_bits(), want[y * job.image.width as usize + x].to_bits());
            }
        }
    }
}

#[test]
fn a_set_cancel_flag_stops_a_render() {
    let job = job(&Node::examples().swap_remove(0).json);
    let renderer = CpuRenderer::new(Some(1), Simd::Auto).unwrap();
    let cancel = CancelFlag::new();
    cancel.cancel();
    let run = TileRequest { job: &job, frame: 0, rect: Rect::full(37, 29) };
    assert!(matches!(renderer.render(&run, &cancel, &|_| ()), Err(worker::RenderError::Cancelled)));
}
