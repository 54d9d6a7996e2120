//! What a GPU is given to compile, tested on machines without one: the host's compiler makes a
//! program of the same text, which must render the reference's bits, and NVRTC must take it.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use proto::Rect;
use scene::real::Real;
use scene::{Image, Job, Layer};
use worker::cuda::{Compiler, Source};
use worker::tape::{Expr, record};
use worker::{Cancel, CpuRenderer, Pixels, Renderer, Simd, TileRun};

/// Runs the kernels on the host, a thread after another: reads `k`, the planes, a tile and the
/// samples; renders in two parts, so that sums are taken up again; writes the planes.
const HOST_MAIN: &str = r"
#include <stdio.h>
#include <stdlib.h>
int main() {
    unsigned planes, samples;
    Tile tile;
    if (fread(k, 4, NUMBERS, stdin) != NUMBERS || fread(&planes, 4, 1, stdin) != 1) return 1;
    if (fread(&samples, 4, 1, stdin) != 1 || fread(&tile, sizeof tile, 1, stdin) != 1) return 1;
    size_t numbers = (size_t)tile.width * tile.height * planes;
    float* out = (float*)calloc(numbers, 4);
    blockDim = {8, 4, 1};
    unsigned blocks = tile.columns * ((tile.height + 3) / 4), middle = samples / 2;
    for (int part = middle == 0 ? 1 : 0; part < 2; ++part)
        for (blockIdx.x = 0; blockIdx.x < blocks; ++blockIdx.x)
            for (threadIdx.y = 0; threadIdx.y < 4; ++threadIdx.y)
                for (threadIdx.x = 0; threadIdx.x < 8; ++threadIdx.x) {
                    render(&tile, 1, {0, 1, blocks, 1}, part ? middle : 0, part ? samples : middle, part, out);
#ifdef LAYER_PLANES
                    if (part) layers(&tile, 1, {0, 1, blocks, 1}, out);
#endif
                }
    return fwrite(out, 4, numbers, stdout) == numbers ? 0 : 1;
}
";

fn scenes() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    let mut found = Vec::new();
    for folder in [root.clone(), root.join("paper")] {
        let entries = std::fs::read_dir(folder).expect("there are scenes");
        found.extend(
            entries
                .map(|entry| entry.expect("a folder can be read").path())
                .filter(|path| path.extension().is_some_and(|e| e == "json")),
        );
    }
    found.sort();
    found
}

/// The job in a size that takes a moment, with every layer.
fn small(path: &Path) -> Job {
    let mut job = scene::parse(&std::fs::read(path).expect("a scene can be read")).expect("a shipped scene is right");
    let layers = vec![Layer::Depth, Layer::Normal, Layer::Position, Layer::Albedo, Layer::Object, Layer::Steps];
    job.image = Image { width: 60, height: 40, samples: 3, layers, ..job.image };
    job
}

fn compile_text(source: &str, folder: &Path) -> PathBuf {
    let (text, program) = (folder.join("kernel.cpp"), folder.join("kernel"));
    std::fs::write(&text, source).expect("a scratch folder can be written");
    let compiler = std::env::var("CXX").unwrap_or_else(|_| "c++".to_owned());
    let compiled = Command::new(&compiler)
        .args(["-std=c++17", "-O1", "-ffp-contract=off", "-o"])
        .args([&program, &text])
        .output()
        .expect("a C++ compiler is installed");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    program
}

fn render_on_host(job: &Job, folder: &Path) -> Pixels {
    let source = Source::new(&job.at(0).expect("a shipped scene is right"));
    let program = compile_text(&format!("{}{HOST_MAIN}", source.text), folder);
    let planes = job.image.channels().len();
    let Image { width, height, samples, .. } = job.image;
    let mut input: Vec<u8> = source.parameters.iter().flat_map(|bits| bits.to_ne_bytes()).collect();
    for word in [planes as u32, samples, 0, 0, width, height, 0, width.div_ceil(8), 0, 0] {
        input.extend(word.to_ne_bytes());
    }
    let mut child =
        Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("the program starts");
    child.stdin.take().expect("it was asked for").write_all(&input).expect("the program reads");
    let output = child.wait_with_output().expect("the program ends");
    assert!(output.status.success());
    let numbers: Vec<f32> =
        output.stdout.chunks_exact(4).map(|bytes| f32::from_ne_bytes(bytes.try_into().expect("four bytes"))).collect();
    let rect = Rect::whole(width, height);
    Pixels { rect, planes: numbers.chunks_exact((width * height) as usize).map(<[f32]>::to_vec).collect() }
}

fn render_on_cpu(job: &Job) -> Pixels {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("this machine has a CPU");
    let rect = Rect::whole(job.image.width, job.image.height);
    renderer.render(&TileRun { job, frame: 0, rect }, &Cancel::new(), &|_| {}).expect("nobody cancels it")
}

#[test]
fn the_text_compiled_by_the_host_renders_the_same_bits() {
    for path in scenes() {
        let job = small(&path);
        let folder = tempfile::tempdir().expect("a scratch folder");
        let (got, want) = (render_on_host(&job, folder.path()), render_on_cpu(&job));
        assert_eq!(got.planes.len(), want.planes.len());
        for (plane, (got, want)) in job.image.channels().iter().zip(got.planes.iter().zip(&want.planes)) {
            let differing = got.iter().zip(want).filter(|(got, want)| got.to_bits() != want.to_bits()).count();
            assert_eq!(differing, 0, "{} of {} differs in {differing} of {} pixels", plane, path.display(), want.len());
        }
    }
}

#[test]
fn the_run_time_compiler_takes_every_scene() {
    let compiler = match Compiler::find() {
        Ok(compiler) => compiler,
        Err(missing) => return println!("skipped: no scene was compiled for a GPU: {missing}"),
    };
    for path in scenes() {
        let job = scene::parse(&std::fs::read(&path).expect("a scene can be read")).expect("a shipped scene is right");
        let source = Source::new(&job.at(0).expect("a shipped scene is right"));
        for architecture in [75, 90] {
            let start = Instant::now();
            let code = compiler.compile(&source.text, architecture);
            let code = code.unwrap_or_else(|trouble| panic!("{} for sm_{architecture}: {trouble}", path.display()));
            assert!(code.starts_with(b"\x7fELF"), "machine code is an ELF file");
            println!("{}: sm_{architecture} in {:.3} s", path.display(), start.elapsed().as_secs_f64());
        }
    }
}

#[test]
fn a_program_that_is_none_is_refused_with_the_compilers_words() {
    let compiler = match Compiler::find() {
        Ok(compiler) => compiler,
        Err(missing) => return println!("skipped: nothing could be refused: {missing}"),
    };
    let refusal = compiler.compile("this is no program", 90).expect_err("it is none").to_string();
    assert!(refusal.contains("error") && refusal.contains("scene.cu"), "{refusal}");
    let unknown = compiler.compile("", 12).expect_err("no such architecture").to_string();
    assert!(unknown.contains("sm_12") && unknown.contains("newer"), "{unknown}");
}

/// Every number of a JSON value that is no count, made a little larger.
fn nudge(value: &mut serde_json::Value) {
    match value {
        serde_json::Value::Number(number) => {
            // Whole powers, counts of iterations and the like are structure; so is nothing at all.
            if let Some(number) = number.as_f64().filter(|number| number.fract() != 0.0) {
                *value = (number * 1.015_625).into();
            }
        }
        serde_json::Value::Array(items) => items.iter_mut().for_each(nudge),
        serde_json::Value::Object(entries) => entries.values_mut().for_each(nudge),
        serde_json::Value::Null | serde_json::Value::Bool(_) | serde_json::Value::String(_) => {}
    }
}

#[test]
fn no_number_of_a_scene_is_in_its_text() {
    for path in scenes() {
        let file = std::fs::read(&path).expect("a scene can be read");
        let mut changed: serde_json::Value = serde_json::from_slice(&file).expect("a scene is JSON");
        nudge(&mut changed["scene"]);
        let before = scene::parse(&file).expect("a shipped scene is right");
        let before = Source::new(&before.at(0).expect("nothing moves in it"));
        let after = scene::parse(changed.to_string().as_bytes()).expect("a little larger is in range");
        let after = Source::new(&after.at(3).expect("nothing moves in it"));
        assert_ne!(before.parameters, after.parameters, "{} has other numbers now", path.display());
        assert!(before.text == after.text, "numbers of {} are in its text", path.display());
    }
}

#[test]
fn loop_states_change_together_and_unused_values_are_not_printed() {
    let tape = record(|recording| {
        recording.entry("swap", |[a, b, count]: [Expr; 3]| {
            let zero = a.splat(0.0);
            let unused = (a + b).sqrt();
            let (a, b, _, _) = Real::repeat(100, (a, b, zero, unused), |(a, b, n, unused)| {
                let next = n + 1.0;
                (next.lt(count), (b, a, next, unused * 2.0))
            });
            vec![a, b]
        });
    });
    let text = tape.text().code;
    assert!(!text.contains("root") && !text.contains("* 2.0f"), "{text}");
    let main = r"
#include <stdio.h>
int main() {
    const swap_result odd = step_swap(1, 2, 3), even = step_swap(1, 2, 4);
    return !(odd.f0 == 2 && odd.f1 == 1 && even.f0 == 1 && even.f1 == 2);
}
";
    let folder = tempfile::tempdir().expect("a scratch folder");
    let program = compile_text(&format!("#define STEP static\n{text}{main}"), folder.path());
    assert!(Command::new(program).status().expect("it runs").success(), "{text}");
}
