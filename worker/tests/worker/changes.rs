//! Edits of scenes: a tile whose record says that an edit can't change it has the same bytes after the edit.

use scene::{Job, reached};
use serde_json::{Value, json};
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TilePixels, TileRequest};

use crate::shipped::shipped;
use proto::Rect;

/// Edge of a tile.
const TILE_PX: u32 = 32;
const SIZE: [u32; 2] = [160, 96];

/// Random numbers (xorshift64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }

    /// From −1 to 1.
    fn signed(&mut self) -> f64 {
        (self.next() % 20_001) as f64 / 10_000.0 - 1.0
    }
}

fn tiles() -> impl Iterator<Item = Rect> {
    (0..SIZE[1]).step_by(TILE_PX as usize).flat_map(|y| {
        (0..SIZE[0]).step_by(TILE_PX as usize).map(move |x| Rect { x, y, width: TILE_PX, height: TILE_PX })
    })
}

fn small(mut document: Value) -> Value {
    let image = document["image"].as_object_mut().expect("an image");
    (image["width"], image["height"]) = (json!(SIZE[0]), json!(SIZE[1]));
    image.insert("samples".into(), json!(2));
    for option in ["region", "scale", "reweight_fireflies"] {
        image.remove(option);
    }
    document
}

fn job(document: &Value) -> Option<Job> {
    scene::parse(document.to_string().as_bytes()).ok()
}

fn render(renderer: &CpuRenderer, job: &Job, rect: Rect) -> TilePixels {
    renderer.render(&TileRequest { job, frame: 0, rect }, &CancelFlag::new(), &|_| ()).expect("pixels")
}

/// Bits of the pixels of a tile.
fn bits(pixels: &TilePixels) -> Vec<u32> {
    pixels.planes.iter().flatten().map(|value| value.to_bits()).collect()
}

/// Pointers to the numbers of the objects and materials.
fn numbers(value: &Value, pointer: &str, found: &mut Vec<String>) {
    match value {
        Value::Number(_) => found.push(pointer.to_owned()),
        Value::Array(all) => {
            all.iter().enumerate().for_each(|(index, value)| numbers(value, &format!("{pointer}/{index}"), found));
        }
        Value::Object(all) => {
            let escaped = |key: &str| key.replace('~', "~0").replace('/', "~1");
            all.iter().for_each(|(key, value)| numbers(value, &format!("{pointer}/{}", escaped(key)), found));
        }
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

/// An edit: a number is changed, a shape is added or removed, an object gets another material.
fn edit(document: &Value, random: &mut Random) -> Value {
    let mut edited = document.clone();
    let objects = document["scene"]["objects"].as_array().expect("objects").len();
    match random.below(8) {
        0 if objects > 1 => {
            edited["scene"]["objects"].as_array_mut().expect("objects").remove(random.below(objects));
        }
        1 => {
            let at = [random.signed(), random.signed(), random.signed()];
            let ball = json!({ "shape": { "translate": { "by": at, "child": { "sphere": { "radius": 0.1 } } } } });
            edited["scene"]["objects"].as_array_mut().expect("objects").push(ball);
        }
        2 => {
            edited["scene"]["objects"][random.below(objects)]["material"] =
                json!({ "diffuse": { "kd": [0.1, 0.7, 0.3] } });
        }
        _ => {
            let mut found = Vec::new();
            for part in ["objects", "materials", "shapes", "lights"] {
                numbers(&document["scene"][part], &format!("/scene/{part}"), &mut found);
            }
            let pointer = &found[random.below(found.len())];
            let number = edited.pointer_mut(pointer).expect("a number");
            let value = number.as_f64().expect("a number");
            let changed = value + random.signed() * (0.1 + 0.2 * value.abs());
            *number = if number.is_f64() { json!(changed) } else { json!(changed.round()) };
        }
    }
    edited
}

/// Counts of tiles.
#[derive(Debug, Default)]
struct Counts {
    edits: usize,
    tiles: usize,
    kept: usize,
    same: usize,
}

fn check(renderer: &CpuRenderer, name: &str, document: &Value, edits: usize, random: &mut Random) -> Counts {
    let before = job(document).expect("a job");
    let mut recorded = Vec::new();
    for rect in tiles() {
        let request = TileRequest { job: &before, frame: 0, rect };
        let (pixels, visited) = renderer.render_recorded(&request, &CancelFlag::new(), &|_| ()).expect("pixels");
        assert_eq!(bits(&pixels), bits(&render(renderer, &before, rect)), "recording changes pixels");
        recorded.push((rect, pixels, visited));
    }
    let mut counts = Counts::default();
    for _ in 0..edits {
        let edited = edit(document, random);
        let Some(after) = job(&edited) else { continue };
        counts.edits += 1;
        let tiles: Vec<_> = recorded.iter().filter_map(|(_, _, visited)| visited.as_ref()).collect();
        let found = reached(&before.at(0).expect("a frame"), &after.at(0).expect("a frame"), &tiles);
        let mut found = match found {
            Ok(found) => found.into_iter(),
            Err(reason) => {
                eprintln!("{name}: {reason}");
                vec![true; tiles.len()].into_iter()
            }
        };
        for (rect, pixels, visited) in &recorded {
            let is_same = bits(pixels) == bits(&render(renderer, &after, *rect));
            let can_change = visited.is_none() || found.next().expect("one for each tile");
            counts.tiles += 1;
            counts.kept += usize::from(!can_change);
            counts.same += usize::from(is_same);
            assert!(is_same || can_change, "{rect:?} of {name} has changed: {edited}");
        }
    }
    counts
}

fn renderer() -> CpuRenderer {
    CpuRenderer::new(None, Simd::Auto).expect("a renderer")
}

/// Edits each shipped scene at random; returns the counts of all.
fn edit_shipped(edits: usize, mut random: Random) -> Counts {
    let (renderer, mut all) = (renderer(), Counts::default());
    for shipped in shipped() {
        let document = small(serde_json::from_slice(&shipped.text).expect("JSON"));
        let counts = check(&renderer, &shipped.name, &document, edits, &mut random);
        eprintln!("{}: {counts:?}", shipped.name);
        let Counts { edits, tiles, kept, same } = counts;
        all.edits += edits;
        all.tiles += tiles;
        all.kept += kept;
        all.same += same;
    }
    eprintln!("all: {all:?}");
    all
}

#[test]
fn tiles_that_an_edit_cannot_change_have_the_same_bytes() {
    assert!(edit_shipped(1, Random(7)).kept > 0, "some tiles are kept");
}

#[test]
#[ignore = "long: 240 random edits of shipped scenes; 2 min"]
fn tiles_that_edits_cannot_change_have_the_same_bytes() {
    let counts = edit_shipped(8, Random(11));
    assert!(counts.edits >= 200, "{counts:?}");
}

/// The shipped scene of chess.
fn chess() -> Value {
    let chess = shipped().into_iter().find(|shipped| shipped.name == "chess").expect("chess");
    serde_json::from_slice(&chess.text).expect("JSON")
}

#[test]
fn edits_of_what_a_lens_blurs_keep_only_tiles_that_they_cannot_reach() {
    let mut document = small(chess());
    let focus = document["scene"]["camera"]["look_at"].clone();
    document["scene"]["camera"]["lens"] = json!({ "aperture": 0.5, "focus": focus, "blades": 5 });
    let counts = check(&renderer(), "chess with a lens", &document, 12, &mut Random(5));
    assert!(0 < counts.kept && counts.kept < counts.tiles, "{counts:?}");
    let mut wider = document.clone();
    wider["scene"]["camera"]["lens"]["aperture"] = json!(0.6);
    let [before, after] = [&document, &wider].map(|document| job(document).expect("a job"));
    let found = reached(&before.at(0).expect("a frame"), &after.at(0).expect("a frame"), &[]);
    assert!(found.is_err_and(|reason| reason.contains("other than surfaces")), "another lens changes every tile");
}

/// Letters, which marches evaluate only in their boxes, among balls, on a floor.
fn letters() -> Value {
    let letter = |string: &str, at: [f64; 3]| {
        let text = json!({ "text": { "string": string, "size": 1.4 } });
        json!({ "shape": { "translate": { "by": at, "child": { "extrude": { "height": 0.3, "profile": text } } } } })
    };
    let mut objects = vec![json!({ "shape": { "plane": { "normal": [0, 1, 0], "offset": -0.1 } } })];
    objects.extend([letter("S", [-1.1, 0.0, 0.0]), letter("B", [0.0, 0.0, -0.8]), letter("R", [0.9, 0.0, 0.3])]);
    for index in 0..8 {
        let at = [f64::from(index % 4) * 0.8 - 1.3, 0.3 + f64::from(index / 4) * 0.7, f64::from(index % 3) * 0.6 - 0.5];
        objects.push(json!({ "shape": { "translate": { "by": at, "child": { "sphere": { "radius": 0.15 } } } } }));
    }
    json!({
        "scene": {
            "camera": { "position": [0.5, 1.2, 5], "look_at": [0, 0.5, 0], "fov": 35 },
            "lights": [{ "directional": { "direction": [1, 2, 1], "color": [2, 2, 2] } }],
            "objects": objects
        },
        "image": { "width": 320, "height": 192 }
    })
}

#[test]
fn letters_that_not_all_rays_see_are_the_same_in_all_arithmetics() {
    let mut document = small(letters());
    let objects = &mut document["scene"]["objects"];
    objects[0]["material"] = json!({ "surface": { "metallic": 1, "roughness": 0.1 } });
    objects[1]["visible"] = json!({ "shadow": false });
    objects[2]["visible"] = json!({ "reflection": false });
    let letters = job(&document).expect("a job");
    let reference = CpuRenderer::new(None, Simd::Scalar).expect("a renderer");
    for rect in tiles() {
        assert_eq!(bits(&render(&renderer(), &letters, rect)), bits(&render(&reference, &letters, rect)), "{rect:?}");
    }
}

#[test]
fn edits_near_letters_keep_only_tiles_that_they_cannot_reach() {
    let counts = check(&renderer(), "letters", &small(letters()), 40, &mut Random(13));
    assert!(0 < counts.kept && counts.kept < counts.tiles, "{counts:?}");
}

/// A ray right above a long letter is nearest to that, but outside of its box it goes as far as a ball that is farther away allows.
#[test]
fn a_ball_behind_a_letter_changes_the_steps_of_rays_outside_of_its_box() {
    let renderer = renderer();
    let mut changed_tiles = 0;
    for height in [0.95, 1.05, 1.15, 1.25] {
        let scene = |ball: [f64; 3]| {
            let text = json!({ "text": { "string": "BBB", "size": 1.4 } });
            json!({
                "scene": {
                    "camera": { "position": [0, height, 7], "look_at": [0, height, -8], "fov": 1.5 },
                    "objects": [
                        { "shape": { "extrude": { "height": 6, "profile": text } } },
                        { "shape": { "translate": { "by": ball, "child": { "sphere": { "radius": 0.15 } } } } },
                        { "shape": { "translate": { "by": [0, 0, -8], "child": { "box": { "size": [20, 20, 1] } } } } }
                    ]
                },
                "image": { "width": SIZE[0], "height": SIZE[1], "format": "exr", "layers": ["steps", "depth"] }
            })
        };
        let before = job(&scene([0.0, 2.4, 0.0])).expect("a job");
        let record = |rect| {
            let request = TileRequest { job: &before, frame: 0, rect };
            let (pixels, visited) = renderer.render_recorded(&request, &CancelFlag::new(), &|_| ()).expect("pixels");
            (rect, pixels, visited.expect("it is recorded"))
        };
        let recorded: Vec<_> = tiles().map(record).collect();
        let visited: Vec<_> = recorded.iter().map(|(_, _, visited)| visited).collect();
        for ball in [[0.4, 2.4, 0.0], [0.0, 2.4, 0.9], [-0.8, 2.3, -0.3]] {
            let after = job(&scene(ball)).expect("a job");
            let found = reached(&before.at(0).expect("a frame"), &after.at(0).expect("a frame"), &visited);
            for ((rect, pixels, _), is_reached) in recorded.iter().zip(found.expect("some tiles are kept")) {
                let is_same = bits(pixels) == bits(&render(&renderer, &after, *rect));
                assert!(is_same || is_reached, "{rect:?} has changed, seen from {height}");
                changed_tiles += u32::from(!is_same);
            }
        }
    }
    assert!(changed_tiles > 0, "the ball changes some tiles");
}

/// Part of a farm's tiles of `chess` that a piece's move by one square changes, and time and bytes of records.
#[test]
#[ignore = "long: renders 1920×1080 twice; 30 s"]
fn moving_a_chess_piece_changes_few_tiles() {
    let renderer = renderer();
    let mut document = chess();
    (document["image"]["width"], document["image"]["height"]) = (json!(1920), json!(1080));
    document["image"]["samples"] = json!(1);
    for piece in
        ["/scene/objects/2/shape/union/of/0/translate/by/0", "/scene/objects/2/shape/union/of/2/translate/by/2"]
    {
        let mut edited = document.clone();
        let place = edited.pointer_mut(piece).expect("a number");
        *place = json!(place.as_f64().expect("a number") - 1.0);
        let (before, after) = (job(&document).expect("a job"), job(&edited).expect("a job"));
        let (mut recorded, mut differ) = (Vec::new(), Vec::new());
        for y in (0..1080_u32).step_by(128) {
            for x in (0..1920).step_by(128) {
                let rect = Rect { x, y, width: 128, height: 128.min(1080 - y) };
                let request = TileRequest { job: &before, frame: 0, rect };
                let (pixels, visited) =
                    renderer.render_recorded(&request, &CancelFlag::new(), &|_| ()).expect("pixels");
                recorded.push(visited.expect("chess is recorded"));
                differ.push(bits(&pixels) != bits(&render(&renderer, &after, rect)));
            }
        }
        let start = std::time::Instant::now();
        let tiles: Vec<_> = recorded.iter().collect();
        let found = reached(&before.at(0).expect("a frame"), &after.at(0).expect("a frame"), &tiles);
        let found = found.expect("some tiles are kept");
        eprintln!("compared in {:?}", start.elapsed());
        assert!(found.iter().zip(&differ).all(|(is_reached, differs)| *is_reached || !differs));
        let count = |all: &[bool]| all.iter().filter(|one| **one).count();
        let (reached, differ, all) = (count(&found), count(&differ), found.len());
        eprintln!("{piece}: {reached} of {all} tiles are rendered again, {differ} differ");
        assert!(reached * 10 <= all * 4, "{reached} of {all}");
    }
}
