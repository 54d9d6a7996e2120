//! Reads EXR files with two independent readers: the exr crate, and the OpenEXR library through its Python package,
//! if that is installed.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use exr::prelude::{FlatSamples, read_first_flat_layer_from_file};
use serde_json::Value;

use crate::skip::skip;
use crate::support::{root, text};

/// Prints each channel's name, type and values, as hex.
const READER: &str = r"
import sys, OpenEXR
part = OpenEXR.File(sys.argv[1], separate_channels=True).parts[0]
for name in sorted(part.channels):
    pixels = part.channels[name].pixels
    print(name, pixels.dtype, pixels.tobytes().hex())
";

/// Checks the standard attributes, and that the camera matrix maps each pixel's position to the pixel's center.
const HEADER: &str = r#"
import sys, numpy, OpenEXR
part = OpenEXR.File(sys.argv[1], separate_channels=True).parts[0]
rate, panorama = float(sys.argv[2]), sys.argv[3] == "panorama"
fps = part.header["framesPerSecond"]
# A plain fraction in some versions of the package.
fps = fps.n / fps.d if hasattr(fps, "n") else float(fps)
assert abs(fps - rate) < 1e-6 * rate, fps
colors = numpy.array(part.header["chromaticities"], dtype=float).ravel()
assert numpy.allclose(colors, [0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329]), colors
camera = numpy.array(part.header["worldToCamera"], dtype=float).reshape(4, 4)
assert numpy.allclose(camera[:3, :3] @ camera[:3, :3].T, numpy.eye(3), atol=1e-5) and numpy.linalg.det(camera) < 0
assert ("worldToNDC" not in part.header) == panorama
plane = {name: part.channels[name].pixels.astype(float) for name in part.channels}
height, width = plane["id"].shape
there = plane["id"] >= 0
points = numpy.stack([plane["P.X"], plane["P.Y"], plane["P.Z"], numpy.ones((height, width))], axis=-1)[there]
# With a shutter, the layers show the middle of the exposure, and the matrices the start of the frame.
if panorama or sys.argv[4] == "blurred" or not len(points):
    print(0)
    sys.exit()
seen = points @ numpy.array(part.header["worldToNDC"], dtype=float).reshape(4, 4)
seen = seen[:, :2] / seen[:, 3:] * [width, height]
y, x = numpy.nonzero(there)
off = numpy.abs(seen - numpy.stack([x + 0.5, y + 0.5], axis=-1)).max()
assert off < 0.02, f"a position is {off} pixels off"
print(len(points))
"#;

/// Raw values of each channel, by name.
type Channels = BTreeMap<String, (&'static str, Vec<u8>)>;

/// Asserts that a float EXR of this job has the documented channels, and that the readers agree.
pub(crate) fn check(path: &Path, job: &Value) {
    let name = path.display();
    let ours = by_exr(path);
    let names: Vec<&str> = ours.keys().map(String::as_str).collect();
    assert_eq!(names, wanted_names(job), "{name}");
    let pixels = job["image"]["width"].as_u64().expect("a width") * job["image"]["height"].as_u64().expect("a height");
    for (channel, (kind, bytes)) in &ours {
        assert_eq!((*kind, bytes.len() as u64), ("float32", pixels * 4), "{name}: {channel}");
    }
    match by_openexr(path) {
        Some(theirs) => assert!(ours == theirs, "{name}: the readers disagree"),
        None => skip("openexr", format_args!("no Python with OpenEXR to read {name} a second time")),
    }
}

/// Checks the camera attributes of a float EXR of this job; returns the number of compared positions, or `None`
/// without a reader.
pub(crate) fn check_header(path: &Path, job: &Value) -> Option<usize> {
    let rate = job["frames"]["fps"].as_f64().unwrap_or(24.0).to_string();
    let projection = job["scene"]["camera"]["projection"].as_str().unwrap_or_default();
    let mut python = Command::new("python3");
    python.env("PYTHONPATH", root().join(".whl")).args(["-c", HEADER]).arg(path);
    let shutter = if job["frames"]["shutter"].is_null() { "sharp" } else { "blurred" };
    python.args([&rate, projection, shutter]);
    let output = python.output().ok()?;
    if text(&output.stderr).contains("ModuleNotFoundError") {
        return None;
    }
    assert!(output.status.success(), "{}: {}", path.display(), text(&output.stderr));
    Some(text(&output.stdout).trim().parse().expect("a number of positions"))
}

/// Names of the channels of a job's EXR with all layers but mattes and motion.
fn wanted_names(job: &Value) -> Vec<String> {
    let names = [
        "R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z", "P.X", "P.Y", "P.Z", "albedo.R", "albedo.G", "albedo.B", "id",
        "steps",
    ];
    let groups = job["image"]["light_groups"].as_array().map(Vec::as_slice).unwrap_or_default();
    let rest = if groups.is_empty() { None } else { Some("rest") };
    let groups = groups.iter().filter_map(Value::as_str).chain(rest);
    let light = groups.flat_map(|group| ["R", "G", "B"].map(|color| format!("light.{group}.{color}")));
    let mut names: Vec<String> = names.into_iter().map(str::to_owned).chain(light).collect();
    names.sort_unstable();
    names
}

fn by_exr(path: &Path) -> Channels {
    let image = read_first_flat_layer_from_file(path).expect("the exr crate reads it");
    let channels = image.layer_data.channel_data.list.into_iter().map(|channel| {
        let values = match channel.sample_data {
            FlatSamples::F32(values) => ("float32", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
            FlatSamples::F16(values) => ("float16", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
            FlatSamples::U32(values) => ("uint32", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        };
        (channel.name.to_string(), values)
    });
    channels.collect()
}

fn by_openexr(path: &Path) -> Option<Channels> {
    let mut python = Command::new("python3");
    python.env("PYTHONPATH", root().join(".whl")).args(["-c", READER]).arg(path);
    let output = python.output().ok()?;
    if text(&output.stderr).contains("ModuleNotFoundError") {
        return None;
    }
    assert!(output.status.success(), "OpenEXR can't read {}: {}", path.display(), text(&output.stderr));
    let lines = text(&output.stdout);
    Some(lines.lines().map(channel).collect())
}

fn channel(line: &str) -> (String, (&'static str, Vec<u8>)) {
    let mut words = line.split(' ');
    let (name, kind, hex) = (words.next(), words.next(), words.next());
    let kind = match kind {
        Some("float32") => "float32",
        Some("float16") => "float16",
        _ => "uint32",
    };
    let digit = |byte: u8| (byte as char).to_digit(16).expect("hex") as u8;
    let bytes =
        hex.expect("values").as_bytes().chunks_exact(2).map(|pair| digit(pair[0]) << 4 | digit(pair[1])).collect();
    (name.expect("a name").to_owned(), (kind, bytes))
}
