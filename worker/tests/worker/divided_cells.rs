//! Cells that a GPU divides, by its source on the host's compiler: they must be those that a CPU divides.

use std::io::Write;
use std::process::{Command, Stdio};

use scene::cells::{BLOCK_CELLS, Division, checksum};
use scene::real::Words;
use serde_json::{Value, json};
use worker::cuda::{DIVISION_POINT, KernelSource};

/// Divides all cells, level by level: reads `uniforms`, the rules, the scene's numbers and the table; writes the table.
const HOST_MAIN: &str = r"
#include <stdio.h>
#include <vector>
template <typename T> static std::vector<T> items() {
    unsigned count = 0;
    if (fread(&count, 4, 1, stdin) != 1) return {};
    std::vector<T> all(count + 1);
    if (fread(all.data(), 4, count, stdin) != count) return {};
    return all;
}
static void run(void (*kernel)(Division), const Division& d, size_t threads) {
    blockDim = {128, 1, 1};
    for (blockIdx.x = 0; blockIdx.x < (threads + 127) / 128; ++blockIdx.x)
        for (threadIdx.x = 0; threadIdx.x < 128; ++threadIdx.x) kernel(d);
}
int main() {
    Division d = {};
    unsigned root;
    if (fread(uniforms, 4, UNIFORM_COUNT, stdin) != UNIFORM_COUNT || fread(&root, 4, 1, stdin) != 1) return 1;
    if (fread(&d.rules, sizeof d.rules, 1, stdin) != 1) return 1;
    std::vector<float> factors = items<float>(), boxes = items<float>(), joins = items<float>();
    std::vector<unsigned> first_boxes = items<unsigned>(), words = items<unsigned>();
    unsigned used = words.size() - 1, state[2];
    d.capacity = CAPACITY;
    words.resize(d.capacity);
    table = d.words = words.data();
    d.state = state;
    d.factors = factors.data(), d.boxes = boxes.data(), d.joins = joins.data(), d.first_boxes = first_boxes.data();
    const unsigned index_mask = (1u << KIND_SHIFT) - 1u;
    std::vector<unsigned> level = {words[root] & index_mask};
    while (!level.empty()) {
        d.missing = level.data();
        d.cells = level.size();
        d.longest = 0;
        for (unsigned cell : level)
            if (d.longest < words[cell + LENGTH] / 2) d.longest = words[cell + LENGTH] / 2;
        std::vector<float> scratch((size_t)d.cells * BLOCK_CELLS * (5 * d.longest + (d.longest + 31) / 32));
        d.scratch = scratch.data();
        d.first_block = used;
        state[0] = used + d.cells * (BLOCK_CELLS + 1), state[1] = 0;
        run(measure, d, (size_t)d.longest * d.cells * BLOCK_CELLS);
        run(divide, d, (size_t)d.cells * BLOCK_CELLS);
        run(publish, d, d.cells);
        if (state[1]) return 2;
        std::vector<unsigned> next;
        for (unsigned place = used; place < used + d.cells * (BLOCK_CELLS + 1); ++place)
            if (words[place] >> KIND_SHIFT == 3) next.push_back(words[place] & index_mask);
        used = state[0];
        level = next;
    }
    return fwrite(words.data(), 4, used, stdout) == used ? 0 : 1;
}
";

/// Room for the words of a scene of this test.
const CAPACITY: usize = 1 << 25;

/// Jobs whose leaves have all sorts of bounds, with all sorts of joins.
fn jobs() -> [(&'static str, Value); 3] {
    let place = |index: u32, salt: u32| f64::from(index * salt % 1009) / 252.0 - 2.0;
    let at = |index: u32| json!([place(index, 17), place(index, 101), place(index, 541)]);
    let ball = |index: u32| json!({ "translate": { "by": at(index), "child": { "sphere": { "radius": 0.11 } } } });
    let rotated = |index: u32| {
        let solid = json!({ "box": { "size": [0.1, 0.3, 0.2], "round": 0.01 } });
        json!({ "translate": { "by": at(index), "child": { "rotate": { "degrees": [index % 90, 20, 0], "child": solid } } } })
    };
    let all = |smooth: f64, shapes: Vec<Value>| json!({ "shape": { "union": { "smooth": smooth, "of": shapes } } });
    let copies = json!({ "shape": { "copies": {
        "child": { "union": { "of": [{ "sphere": { "radius": 0.2 } }, { "box": { "size": [0.5, 0.1, 0.1] } }] } },
        "at": (0..20).map(|index| json!({ "by": at(index), "scale": 0.3 + 0.1 * f64::from(index) })).collect::<Vec<_>>()
    } } });
    let fractal = json!({ "shape": { "translate": { "by": [0.5, 0, 0.3], "child": { "mandelbulb": { "power": 8, "iterations": 6 } } } } });
    let ground = json!({ "shape": { "plane": { "normal": [0, 1, 0], "offset": -1.5 } } });
    [
        ("a smooth union", json!([all(0.1, (0..700).map(ball).collect())])),
        ("sharp unions and scaled copies", json!([all(0.0, (0..300).map(rotated).collect()), copies.clone(), ground])),
        ("a fractal", json!([all(0.05, (0..60).map(rotated).chain((60..120).map(ball)).collect()), fractal, copies])),
    ]
}

fn bytes_of(division: &Division) -> Vec<u8> {
    let Division { center, unit, levels, coarse_levels, root, leaf_lists, short_list, shorter, max_stalls, .. } =
        division;
    let Division { depth: _, factors, first_boxes, boxes, joins, .. } = division;
    let rules = [center.x, center.y, center.z, *unit, *shorter].map(f32::to_bits);
    let rules = rules.into_iter().chain([*levels, *coarse_levels, *leaf_lists, *short_list, *max_stalls]);
    let mut words: Vec<u32> = std::iter::once(*root).chain(rules).collect();
    for numbers in [factors, boxes, joins] {
        words.push(numbers.len() as u32);
        words.extend(numbers.iter().map(|number| number.to_bits()));
    }
    words.push(first_boxes.len() as u32);
    words.extend(first_boxes);
    words.iter().flat_map(|word| word.to_ne_bytes()).collect()
}

/// The table of a job, all of whose cells were divided by the source of its kernels.
fn divided(source: &KernelSource, division: &Division, table: &Words) -> Words {
    let folder = tempfile::tempdir().expect("a scratch folder");
    let program = source.division.as_ref().expect("a scene with cells");
    let (_, kernels) = program.split_once(DIVISION_POINT).expect("the kernels are marked");
    let main = HOST_MAIN.replace("CAPACITY", &format!("{CAPACITY}u"));
    let program = crate::cuda::compile_text(&format!("{}{kernels}{main}", source.text), folder.path());
    let present = table.after(0);
    let mut input: Vec<u8> = source.parameters.iter().flat_map(|bits| bits.to_ne_bytes()).collect();
    input.extend(bytes_of(division));
    input.extend((present.len() as u32).to_ne_bytes());
    input.extend(present.iter().flat_map(|word| word.to_ne_bytes()));
    let mut child =
        Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("the program starts");
    child.stdin.take().expect("standard input is piped").write_all(&input).expect("the program reads");
    let output = child.wait_with_output().expect("the program ends");
    assert!(output.status.success(), "{:?}", output.status);
    let words = output.stdout.chunks_exact(4).map(|bytes| u32::from_ne_bytes(bytes.try_into().expect("four bytes")));
    Words::from(words.collect::<Vec<u32>>())
}

#[test]
fn a_gpu_divides_the_cells_that_a_cpu_divides() {
    for (name, objects) in jobs() {
        let scene = json!({ "camera": { "position": [0, 1, 6], "look_at": [0, 0, 0] }, "objects": objects });
        let text = json!({ "scene": scene, "image": { "width": 8, "height": 8 } }).to_string();
        let job = scene::parse(text.as_bytes()).expect("a valid job");
        let source = KernelSource::new(&job.at(0).expect("a valid frame")).expect("a valid tape");
        let table = source.table.as_ref().expect("a scene with cells");
        let division = table.division().expect("cells that are divided when they are needed");
        let by_gpu = checksum(&divided(&source, division, table), division.root);
        table.make_all();
        let blocks = table.used() / (BLOCK_CELLS as usize + 1);
        assert!(blocks > 1000, "{name} has few cells");
        assert_eq!(by_gpu, checksum(table, division.root), "the cells of {name} differ");
    }
}

/// The source of a picture of this many overlapping balls.
fn of_balls(count: usize) -> KernelSource {
    let place = |index: usize| [index % 20, index / 20 % 20, index / 400];
    let balls: Vec<Value> = (0..count)
        .map(|index| json!({ "translate": { "by": place(index), "child": { "sphere": { "radius": 0.6 } } } }))
        .collect();
    let scene = json!({ "camera": { "position": [0, 1, 60], "look_at": [0, 0, 0] },
        "objects": [{ "shape": { "union": { "smooth": 0.2, "of": balls } } }] });
    let text = json!({ "scene": scene, "image": { "width": 8, "height": 8 } }).to_string();
    let job = scene::parse(text.as_bytes()).expect("a valid job");
    KernelSource::new(&job.at(0).expect("a valid frame")).expect("a valid tape")
}

#[test]
fn only_the_outermost_cells_with_long_lists_are_made_before_a_gpu_asks() {
    let few = of_balls(1000);
    assert!(few.table.expect("a scene with cells").outermost().is_empty(), "its list is short");
    let many = of_balls(9000);
    let table = many.table.expect("a scene with cells");
    let [outermost] = table.outermost()[..] else { panic!("one cell has all balls") };
    assert_ne!(table.make(outermost), outermost, "it is divided");
    let used = table.used();
    for missing in table.outermost() {
        assert_ne!(missing, outermost);
        table.make(missing);
    }
    assert!(table.outermost().is_empty(), "cells further inside are made when a GPU asks for them");
    assert!(table.used() < 10 * used, "few cells were made");
}
