//! Kernel source, tested on machines without a GPU: the host's compiler builds a program from it, which must
//! render the reference's bits, and NVRTC must compile it.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use proto::Rect;
use rayon::prelude::*;
use scene::backgrounds::Background;
use scene::camera::{Lens, Projection};
use scene::kinds::Example;
use scene::lights::Light;
use scene::real::Real;
use scene::real::Table;
use scene::sample_count::BATCH;
use scene::{ImageSpec, Job, effects};
use serde_json::{Value, json};
use worker::cuda::{Compiler, KernelSource};
use worker::tape::{Expr, record};
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TilePixels, TileRequest};

use crate::shipped::{LAYERS, Shipped, few, large, shipped};
use crate::skip::skip;
use crate::{batches, light_groups};

/// Runs the kernels on the host, one thread after another: reads the planes, the samples, a tile, and for each round and
/// instant its `uniforms`, table and samples; renders in two parts or more, so that sums are continued; writes the planes.
const HOST_MAIN: &str = r"
#include <stdio.h>
#include <stdlib.h>
static unsigned word() {
    unsigned word;
    if (fread(&word, 4, 1, stdin) != 1) exit(1);
    return word;
}
int main() {
    const unsigned planes = word(), samples = word();
    Tile tile;
    if (fread(&tile, sizeof tile, 1, stdin) != 1) return 1;
    size_t numbers = (size_t)tile.width * tile.height * planes;
#ifdef BATCHES_PLANE
    float* out = (float*)calloc(numbers + (size_t)tile.width * tile.height * LIGHT_PLANES, 4);
#else
    float* out = (float*)calloc(numbers, 4);
#endif
    const unsigned count = tile.columns * ((tile.height + 3) / 4);
    unsigned* groups = (unsigned*)malloc(4 * (size_t)(count / BLOCK_GROUP + 1));
    for (unsigned group = 0; group <= count / BLOCK_GROUP; ++group) groups[group] = group;
    const Blocks blocks = {groups, 0, 8, 4};
    for (unsigned launches = word(); launches > 0; --launches) {
        if (fread(uniforms, 4, UNIFORM_COUNT, stdin) != UNIFORM_COUNT) return 1;
        const unsigned words = word();
        unsigned* read = (unsigned*)malloc(4 * (size_t)words);
        if (fread(read, 4, words, stdin) != words) return 1;
        table = read;
        const unsigned from = word(), to = word();
        for (unsigned first = from, end = to - from > 1 ? from + (to - from) / 2 : to; first < to; first = end, end = to) {
            const unsigned end_of_batch = (first / BATCH + 1) * BATCH;
            if (end > end_of_batch) end = end_of_batch;
            for (blockIdx.x = 0; blockIdx.x < count; ++blockIdx.x)
                run_block([&] {
                    render(&tile, 1, blocks, first, end, end == samples, out);
#ifdef AOV_PLANES
                    if (end == samples) layers(&tile, 1, blocks, out);
#endif
                });
        }
    }
    return fwrite(out, 4, numbers, stdout) == numbers ? 0 : 1;
}
";

/// Runs the threads of a block one after another.
const SERIAL_BLOCK: &str = r"
template <typename Thread> static void run_block(Thread thread) {
    for (threadIdx.x = 0; threadIdx.x < 32; ++threadIdx.x) thread();
}
";

/// A warp of 32 threads of the host, which exchange numbers as a GPU's threads do: instead of the host's lines.
const HOST_WARP: &str = r"
#include <pthread.h>
#include <thread>
#include <vector>
static pthread_barrier_t barrier;
static float numbers_of_lanes[32];
INLINE_FN float from_lane(float x, unsigned lane) {
    numbers_of_lanes[threadIdx.x % 32] = x;
    pthread_barrier_wait(&barrier);
    const float other = numbers_of_lanes[lane];
    pthread_barrier_wait(&barrier);
    return other;
}
INLINE_FN unsigned threads_together() { return 32u; }
INLINE_FN unsigned count_of(unsigned threads, bool condition) {
    numbers_of_lanes[threadIdx.x % 32] = condition ? 1.0f : 0.0f;
    pthread_barrier_wait(&barrier);
    unsigned count = 0;
    for (unsigned lane = 0; lane < threads; ++lane) count += numbers_of_lanes[lane] != 0.0f;
    pthread_barrier_wait(&barrier);
    return count;
}
";

/// Runs the threads of a block, `TOGETHER` for each pixel, in warps.
const WARP_BLOCK: &str = r"
template <typename Thread> static void run_block(Thread thread) {
    for (unsigned first = 0; first < 32 * TOGETHER; first += 32) {
        pthread_barrier_init(&barrier, nullptr, 32);
        std::vector<std::thread> warp;
        for (unsigned lane = 0; lane < 32; ++lane)
            warp.emplace_back([=] { threadIdx = {first + lane, 0, 0}; thread(); });
        for (std::thread& one : warp) one.join();
    }
}
";

/// The job in a small size, with every layer.
fn small(shipped: &Shipped) -> Job {
    let job = shipped.job();
    let image = ImageSpec { width: 60, height: 40, samples: 3.into(), layers: LAYERS.to_vec(), ..job.image.clone() };
    job.with_image(image)
}

pub(crate) fn compile_text(source: &str, folder: &Path) -> PathBuf {
    let (text, program) = (folder.join("kernel.cpp"), folder.join("kernel"));
    std::fs::write(&text, source).expect("a scratch folder can be written");
    let compiler = std::env::var("CXX").unwrap_or_else(|_| "c++".to_owned());
    let compiled = Command::new(&compiler)
        .args(["-std=c++17", "-O1", "-ffp-contract=off", "-pthread", "-o"])
        .args([&program, &text])
        .output()
        .expect("a C++ compiler is installed");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    program
}

/// A program of the host from kernel source, whose threads run one after another.
fn serial(text: &str) -> String {
    format!("{text}{SERIAL_BLOCK}{HOST_MAIN}")
}

/// A program of the host from kernel source, whose blocks are warps.
fn in_warps(text: &str) -> String {
    let (before, rest) = text.split_once("// A thread of the host has no warp").expect("the host's part is marked");
    let (_, after) = rest.split_once("#endif").expect("it ends");
    let before = before.replace(
        "static Index blockIdx, blockDim, threadIdx;",
        "static Index blockIdx, blockDim; static thread_local Index threadIdx;",
    );
    assert!(before.contains("thread_local"));
    format!("{before}{HOST_WARP}#endif{after}{WARP_BLOCK}{HOST_MAIN}")
}

/// Words of the table of a kernel source, with everything made.
fn table_of(source: &KernelSource) -> Vec<u32> {
    let words = |table: &Table| {
        table.make_all();
        table.after(0)
    };
    source.table.as_ref().map(words).unwrap_or_default()
}

fn render_on_host(job: &Job, folder: &Path, program_of: fn(&str) -> String) -> TilePixels {
    let exposure = job.exposure(0).expect("a shipped scene is valid");
    let source_at = |instant| KernelSource::new(instant).expect("a recorded tape is valid");
    let sources: Vec<KernelSource> = exposure.instants.iter().map(source_at).collect();
    assert!(sources.iter().all(|source| source.text == sources[0].text), "instants differ in numbers alone");
    let program = compile_text(&program_of(&sources[0].text), folder);
    let planes = job.image.film().rendered_channels().len();
    let ImageSpec { width, height, ref samples, .. } = job.image;
    let tables: Vec<Vec<u32>> = sources.iter().map(table_of).collect();
    let rounds = exposure.samples();
    let tile = [0, 0, width, height, 0, width.div_ceil(8), 0, 0, width, 0, width * height, 0];
    let launches = rounds.iter().map(|instants| instants.len() as u32).sum();
    let mut input: Vec<u32> = [planes as u32, samples.max()].into_iter().chain(tile).chain([launches]).collect();
    for round in &rounds {
        for ((source, table), samples) in sources.iter().zip(&tables).zip(round) {
            input.extend(&source.parameters);
            input.push(table.len() as u32);
            input.extend(table);
            input.extend([samples.start, samples.end]);
        }
    }
    let input: Vec<u8> = input.into_iter().flat_map(u32::to_ne_bytes).collect();
    let mut child =
        Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("the program starts");
    child.stdin.take().expect("standard input is piped").write_all(&input).expect("the program reads");
    let output = child.wait_with_output().expect("the program ends");
    assert!(output.status.success());
    let numbers: Vec<f32> =
        output.stdout.chunks_exact(4).map(|bytes| f32::from_ne_bytes(bytes.try_into().expect("four bytes"))).collect();
    let rect = Rect::full(width, height);
    TilePixels { rect, planes: numbers.chunks_exact((width * height) as usize).map(<[f32]>::to_vec).collect() }
}

fn render_on_cpu(job: &Job) -> TilePixels {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("this machine has a CPU");
    let rect = Rect::full(job.image.width, job.image.height);
    renderer.render(&TileRequest { job, frame: 0, rect }, &CancelFlag::new(), &|_| {}).expect("it is not cancelled")
}

/// Compares the host program's pixels of these jobs with the CPU renderer's, several jobs at a time.
fn assert_same_on_host(jobs: &[(String, Job)], program_of: fn(&str) -> String) {
    let compare = |(name, job): &(String, Job)| {
        let folder = tempfile::tempdir().expect("a scratch folder");
        let (got, want) = (render_on_host(job, folder.path(), program_of), render_on_cpu(job));
        assert_eq!(got.planes.len(), want.planes.len());
        let channels = job.image.film().rendered_channels();
        // The error follows from the sums after each round of samples, which the host program does not keep.
        let error = job.image.film().error_plane();
        let planes = channels.iter().zip(got.planes.iter().zip(&want.planes)).enumerate();
        let counts = planes.filter(|(plane, _)| Some(*plane) != error).map(|(_, (channel, (got, want)))| {
            let differing = got.iter().zip(want).filter(|(got, want)| got.to_bits() != want.to_bits()).count();
            (differing > 0).then(|| format!("{channel} of {name} differs in {differing} pixels"))
        });
        counts.flatten().collect::<Vec<String>>()
    };
    let wrong: Vec<String> = jobs.par_iter().flat_map_iter(compare).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Shipped scenes in a small size, with their names.
fn in_small(scenes: &[Shipped]) -> Vec<(String, Job)> {
    scenes.iter().map(|shipped| (shipped.name.clone(), small(shipped))).collect()
}

/// Compiles these scenes as a GPU worker would, for compute capabilities given as ten times their number.
fn assert_compiled(jobs: &[(String, Job)], architectures: &[u32]) {
    let compiler = match Compiler::find() {
        Ok(compiler) => compiler,
        Err(missing) => return skip("nvrtc", format_args!("no scene was compiled for a GPU: {missing}")),
    };
    for (name, job) in jobs {
        let source = KernelSource::new(&job.at(0).expect("a shipped scene is valid"));
        let source = source.expect("a recorded tape is valid");
        for &architecture in architectures {
            let code = compiler.compile(&source.text, architecture);
            let code = code.unwrap_or_else(|error| panic!("{name} for sm_{architecture}: {error}"));
            assert!(code.starts_with(b"\x7fELF"), "machine code is an ELF file");
            if let Some(division) = &source.division {
                compiler.compile(division, architecture).unwrap_or_else(|error| panic!("{name}: {error}"));
            }
        }
    }
}

/// Scenes in their size, with their names.
fn in_full(scenes: &[Shipped]) -> Vec<(String, Job)> {
    scenes.iter().map(|shipped| (shipped.name.clone(), shipped.job())).collect()
}

/// The JSON of examples.
fn values(examples: Vec<Example>) -> Vec<Value> {
    examples.into_iter().map(|example| serde_json::from_str(&example.json).expect("an example is JSON")).collect()
}

/// A job for each background, with all lights that can be used with it; projections and effects alternate.
fn jobs_of_all_kinds() -> Vec<Job> {
    let (projections, effects) = (values(Projection::examples()), values(effects::examples()));
    let backgrounds = values(Background::examples());
    let jobs = projections.len().max(effects.len()).max(backgrounds.len());
    let with = |index: usize, lights: &[Value]| {
        let mut scene = json!({ "background": backgrounds[index % backgrounds.len()], "lights": lights,
            "camera": { "position": [1.5, 1.4, 3.2], "look_at": [0, 0.6, 0], "projection": projections[index % projections.len()] },
            "objects": [{ "shape": { "sphere": { "radius": 1 } }, "material": { "diffuse": { "ks": [0.3, 0.3, 0.3] } } },
                        { "shape": { "plane": { "normal": [0, 1, 0], "offset": -1 } } }] });
        for (key, value) in effects[index % effects.len()].as_object().expect("an effect has a key") {
            scene[key] = value.clone();
        }
        let image = json!({ "width": 40, "height": 24, "samples": 2, "format": "exr", "precision": "float" });
        scene::parse(json!({ "scene": scene, "image": image }).to_string().as_bytes())
    };
    let job = |index| {
        let lights: Vec<Value> = values(Light::examples());
        let shining: Vec<Value> =
            lights.into_iter().filter(|light| with(index, std::slice::from_ref(light)).is_ok()).collect();
        with(index, &shining).expect("each light alone is valid")
    };
    (0..jobs).map(job).collect()
}

/// A job for each lens; projections alternate.
fn jobs_with_lenses() -> Vec<Job> {
    let projections = [json!("perspective"), json!({ "orthographic": { "height": 3 } })];
    let job = |(index, lens): (usize, Value)| {
        let scene = json!({ "camera": { "position": [1.5, 1.4, 3.2], "look_at": [0, 0.6, 0], "lens": lens,
                "projection": projections[index % projections.len()] },
            "objects": [{ "shape": { "sphere": { "radius": 1 } } },
                        { "shape": { "plane": { "normal": [0, 1, 0], "offset": -1 } } }] });
        let image = json!({ "width": 40, "height": 24, "samples": 8, "format": "exr", "precision": "float" });
        scene::parse(json!({ "scene": scene, "image": image }).to_string().as_bytes()).expect("an example is valid")
    };
    values(Lens::examples()).into_iter().enumerate().map(job).collect()
}

#[test]
fn source_of_every_scene_part_is_bit_identical() {
    let jobs = [jobs_of_all_kinds(), jobs_with_lenses()].concat().into_iter().enumerate();
    let jobs: Vec<(String, Job)> = jobs.map(|(index, job)| (format!("job {index} of all kinds"), job)).collect();
    assert_same_on_host(&jobs, serial);
}

#[test]
fn source_compiled_by_the_host_is_bit_identical() {
    assert_same_on_host(&in_small(&few()), serial);
}

#[test]
fn samples_that_a_warp_renders_together_are_bit_identical() {
    let jobs = in_small(&few()[..2]).into_iter().map(|(name, job)| {
        let image = ImageSpec { width: 24, height: 16, samples: 8.into(), ..job.image.clone() };
        (name, job.with_image(image))
    });
    let lens = jobs_with_lenses().into_iter().take(1).map(|job| ("a lens".to_owned(), job));
    let jobs: Vec<(String, Job)> = jobs.chain(lens).collect();
    assert_same_on_host(&jobs, in_warps);
}

#[test]
fn paths_whose_marches_a_warp_pauses_are_bit_identical() {
    let mut scenes = large();
    scenes.retain(|shipped| shipped.name == "light/cornell");
    let jobs: Vec<(String, Job)> = in_small(&scenes)
        .into_iter()
        .map(|(name, job)| {
            let image = ImageSpec { width: 24, height: 16, ..job.image.clone() };
            (name, job.with_image(image))
        })
        .collect();
    assert_eq!(jobs.len(), 1);
    for program_of in [serial, in_warps] {
        assert_same_on_host(&jobs, program_of);
    }
}

#[test]
fn sums_of_batches_are_bit_identical() {
    let jobs = [json!("direct"), json!({ "path": { "max_bounces": 2 } })]
        .map(|integrator| (format!("batches, {integrator}"), batches::job(&integrator, 0.0, json!(2 * BATCH + 88))));
    for program_of in [serial, in_warps] {
        assert_same_on_host(&jobs, program_of);
    }
}

/// Small jobs of light groups in each scene that a GPU renders in one round; the first has levels of brightness.
fn parts_of_light() -> Vec<(String, Job)> {
    let small = |text: &mut Value, [width, height, samples]: [u32; 3]| {
        for (key, value) in [("width", width), ("height", height), ("samples", samples)] {
            text["image"][key] = json!(value);
        }
    };
    let mut reweighted = light_groups::scenes().swap_remove(0).1;
    small(&mut reweighted, [16, 8, 16]);
    reweighted["image"]["reweight_fireflies"] = json!(true);
    let scenes = light_groups::scenes()
        .into_iter()
        // The host decides after each round.
        .filter(|(name, _)| !["lens and adaptive samples", "motion blur", "denoised"].contains(name))
        .map(|(name, mut text)| {
            small(&mut text, [24, 16, 3]);
            (format!("light groups: {name}"), light_groups::parsed(&text))
        });
    std::iter::once(("light by its brightness".to_owned(), light_groups::parsed(&reweighted))).chain(scenes).collect()
}

#[test]
fn parts_of_light_are_bit_identical() {
    let jobs = parts_of_light();
    assert_same_on_host(&jobs[..1], in_warps);
    assert_same_on_host(&jobs[1..3], serial);
}

#[test]
#[ignore = "long: compiles a program for each way in which light is found; 30 s"]
fn parts_of_all_light_are_bit_identical() {
    let jobs = parts_of_light();
    assert_same_on_host(&jobs, serial);
    assert_same_on_host(&jobs[..2], in_warps);
}

#[test]
#[ignore = "long: compiles the source of every shipped scene with the host's compiler; 2 minutes"]
fn every_scene_compiled_by_the_host_is_bit_identical() {
    assert_same_on_host(&in_small(&shipped()), serial);
}

#[test]
fn nvrtc_compiles_a_few_scenes_and_parts_of_light() {
    assert_compiled(&in_full(&few()), &[75]);
    // Light groups, levels of brightness, and the denoiser's guides.
    let scenes = light_groups::scenes().into_iter().filter(|(name, _)| *name == "denoised");
    let parts: Vec<(String, Job)> = scenes.map(|(name, text)| (name.to_owned(), light_groups::parsed(&text))).collect();
    assert!(parts.iter().any(|(_, job)| job.image.is_reweighted() && job.image.is_denoised()));
    assert_compiled(&parts, &[75]);
}

#[test]
#[ignore = "long: compiles every shipped scene for two architectures; 1 minute"]
fn nvrtc_compiles_every_scene() {
    assert_compiled(&in_full(&shipped()), &[75, 90]);
}

#[test]
fn invalid_source_is_rejected_with_the_compilers_message() {
    let compiler = match Compiler::find() {
        Ok(compiler) => compiler,
        Err(missing) => return skip("nvrtc", format_args!("no source could be rejected: {missing}")),
    };
    let refusal = compiler.compile("this is no program", 90).expect_err("it is none").to_string();
    assert!(refusal.contains("error") && refusal.contains("scene.cu"), "{refusal}");
    let unknown = compiler.compile("", 12).expect_err("no such architecture").to_string();
    assert!(unknown.contains("sm_12") && unknown.contains("newer"), "{unknown}");
}

/// Every number of a JSON value that is not a count, slightly increased.
fn nudge(value: &mut Value) {
    match value {
        Value::Number(number) => {
            // Integer powers, iteration counts and similar numbers are structure; so is 0.
            if let Some(number) = number.as_f64().filter(|number| number.fract() != 0.0) {
                *value = (number * 1.015_625).into();
            }
        }
        Value::Array(items) => items.iter_mut().for_each(nudge),
        Value::Object(entries) => entries.values_mut().for_each(nudge),
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

#[test]
fn the_longest_paths_have_a_valid_program() {
    let job = serde_json::json!({
        "scene": {
            "integrator": { "path": { "max_bounces": 32 } },
            "march": { "max_steps": 65_536 },
            "camera": { "position": [0, 0, 4], "look_at": [0, 0, 0] },
            "objects": [{ "shape": { "sphere": { "radius": 1 } }, "material": { "diffuse": {} } }]
        },
        "image": { "width": 8, "height": 8, "samples": 65_536 }
    });
    let job = scene::parse(job.to_string().as_bytes()).expect("a valid job");
    KernelSource::new(&job.at(0).expect("it is not animated")).expect("a recorded tape is valid");
}

#[test]
fn kernel_source_does_not_depend_on_a_scenes_numbers() {
    for Shipped { name, text } in shipped() {
        let mut changed: Value = serde_json::from_slice(&text).expect("a scene is JSON");
        nudge(&mut changed["scene"]);
        let before = scene::parse(&text).expect("a shipped scene is valid");
        let before = KernelSource::new(&before.at(0).expect("it is not animated")).expect("a recorded tape is valid");
        let after = scene::parse(changed.to_string().as_bytes()).expect("a little larger is in range");
        let after = KernelSource::new(&after.at(3).expect("it is not animated")).expect("a recorded tape is valid");
        assert_ne!(before.parameters, after.parameters, "{name} has other uniforms");
        assert!(before.text == after.text, "numbers of {name} are in its source");
    }
}

#[test]
fn loop_variables_change_together_and_unused_values_are_omitted() {
    let tape = record(|recording| {
        recording.entry("swap", |[a, b, count]: [Expr; 3]| {
            let zero = a.constant(0.0);
            let unused = (a + b).sqrt();
            let (a, b, _, _) = Real::repeat(100, (a, b, zero, unused), |(a, b, n, unused)| {
                let next = n + 1.0;
                (next.lt(count), (b, a, next, unused * 2.0))
            });
            vec![a, b]
        });
    });
    let text = tape.to_c().expect("a recorded tape is valid").code;
    assert!(!text.contains("sqrt_rn") && !text.contains("* 2.0f"), "{text}");
    let main = r"
#include <stdio.h>
int main() {
    const swap_result odd = step_swap(1, 2, 3), even = step_swap(1, 2, 4);
    return !(odd.f0 == 2 && odd.f1 == 1 && even.f0 == 1 && even.f1 == 2);
}
";
    let folder = tempfile::tempdir().expect("a scratch folder");
    let program = compile_text(&format!("#define INLINE_FN static\n{text}{main}"), folder.path());
    assert!(Command::new(program).status().expect("it runs").success(), "{text}");
}
