//! Renders the spheres of a job of `tests/figures/many.py` with fidget: a height map with normals, and prints how long
//! building and rendering took. `cargo run --release -- JOB EDGE_PX [sharp]`

use std::time::Instant;

use fidget::context::{Context, Node};
use fidget::jit::JitShape;
use fidget::raster::voxel::RenderConfig;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let job: serde_json::Value = serde_json::from_slice(&std::fs::read(&arguments[1]).expect("a file")).expect("JSON");
    let (edge, sharp): (u32, bool) = (arguments[2].parse().expect("pixels"), arguments.len() > 3);
    let union = &job["scene"]["objects"][0]["shape"]["union"];
    let number = |value: &serde_json::Value| value.as_f64().expect("a number") as f32;
    let width = number(&union["smooth"]);
    let start = Instant::now();
    let mut context = Context::new();
    let (x, y, z) = (context.x(), context.y(), context.z());
    let mut sphere = |shape: &serde_json::Value| {
        let moved = &shape["translate"];
        let radius = number(&moved["child"]["sphere"]["radius"]);
        let squares = [x, y, z].into_iter().enumerate().map(|(axis, coordinate)| {
            let offset = context.sub(coordinate, number(&moved["by"][axis])).expect("a node");
            context.square(offset).expect("a node")
        });
        let squares: Vec<Node> = squares.collect();
        let sum = context.add(squares[0], squares[1]).expect("a node");
        let sum = context.add(sum, squares[2]).expect("a node");
        let length = context.sqrt(sum).expect("a node");
        context.sub(length, radius).expect("a node")
    };
    let mut nodes: Vec<Node> = union["of"].as_array().expect("a list").iter().map(&mut sphere).collect();
    // Joined in pairs, so that the tree is balanced.
    while nodes.len() > 1 {
        nodes = nodes
            .chunks(2)
            .map(|pair| {
                let &[a, b] = pair else { return pair[0] };
                let least = context.min(a, b).expect("a node");
                if sharp {
                    return least;
                }
                let apart = context.sub(a, b).expect("a node");
                let apart = context.abs(apart).expect("a node");
                let overlap = context.sub(width, apart).expect("a node");
                let overlap = context.max(overlap, 0.0).expect("a node");
                let seam = context.square(overlap).expect("a node");
                let seam = context.mul(seam, 0.25 / width).expect("a node");
                context.sub(least, seam).expect("a node")
            })
            .collect();
    }
    let shape = JitShape::new(&context, nodes[0]).expect("a shape");
    let built = start.elapsed();
    let start = Instant::now();
    let image = RenderConfig::from_size(edge.into()).run(shape.try_into().expect("no variables"));
    let hits = image.iter().filter(|pixel| pixel.depth > 0).count();
    println!("built in {built:.2?}, rendered in {:.2?}, {hits} pixels are hit", start.elapsed());
}
