//! The yardstick of compiled distances: straight C++ of the same tape, compiled by this machine's compiler.
//!
//! It runs as a process of its own and takes turns with the evaluator that it is compared with.

mod measure;

use std::ffi::OsString;
use std::fmt::Write as _;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

use serde::{Serialize, Serializer};
use worker::Simd;
use worker::bench::{DISTANCE, POINTS, Spread};
use worker::tape::{InvalidTape, Tape};

pub(crate) use measure::{Arguments, run};

const TEMPLATE: &str = include_str!("straight.cpp");
/// Begin of the part for each number of packets, place of the distance in it, and its end.
const MARKS: [&str; 3] = ["// ---- packets ----\n", "// ---- the distance ----\n", "// ---- the program ----\n"];
/// Numbers of packets that the program tries to evaluate at once.
const PACKETS: [usize; 3] = [1, 2, 4];

/// Rate of straight C++, and the evaluator's relative to it.
#[derive(Clone, Debug, Serialize)]
struct StraightReport {
    /// Distances a second, on one thread, at the median.
    points_per_second: f64,
    /// Packets of lanes that it evaluates at once: the fastest number.
    packets: u32,
    /// The evaluator's rate divided by this one, in the same round.
    ratio: Spread,
}

/// Why there is no yardstick.
#[derive(Debug, thiserror::Error)]
enum StraightError {
    /// Back ends without vector instructions.
    #[error("straight C++ is compiled for avx512 and avx2, not for {0}")]
    NoVectors(&'static str),
    /// Only straight code is printed.
    #[error("the scene's distance has loops or branches, for which there is no straight C++")]
    Loops,
    /// A bug in sdfarm.
    #[error(transparent)]
    InvalidTape(#[from] InvalidTape),
    /// No compiler.
    #[error(
        "no C++ compiler was found, so there is no straight C++ to compare with: `apt-get install g++`, or name one in CXX"
    )]
    NoCompiler,
    /// A compiler that refuses the source.
    #[error("the C++ compiler {} did not compile the yardstick: {message}", compiler.display())]
    Compiler {
        /// Its name.
        compiler: OsString,
        /// Its output.
        message: String,
    },
    /// A program that does not do what it should.
    #[error("straight C++ could not be measured: {0}")]
    Program(io::Error),
    /// Other work than the evaluator's.
    #[error("straight C++ gives other distances at {0} of {POINTS} points")]
    Differs(usize),
}

/// As its message.
impl Serialize for StraightError {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(self)
    }
}

/// A running program of straight C++.
#[derive(Debug)]
struct Straight {
    child: Child,
    input: Option<ChildStdin>,
    output: ChildStdout,
    packets: u32,
    _folder: tempfile::TempDir,
}

impl Straight {
    /// Compiles and starts the distance of a tape, and compares its bits with these distances of these points.
    fn build(tape: &Tape, simd: Simd, points: &[f32], distances: &[f32]) -> Result<Self, StraightError> {
        let options: &[&str] = match simd {
            Simd::Avx512 => &["-mavx512f", "-mavx512dq", "-mavx512bw", "-mavx512vl", "-mprefer-vector-width=512"],
            Simd::Avx2 => &["-mavx2"],
            Simd::Auto | Simd::Portable | Simd::Scalar => return Err(StraightError::NoVectors(simd.name())),
        };
        let text = source(tape)?;
        let folder = tempfile::tempdir().map_err(StraightError::Program)?;
        let program = compile(&text, options, folder.path())?;
        Self::start(&program, folder, points, distances)
    }

    fn start(
        program: &Path,
        folder: tempfile::TempDir,
        points: &[f32],
        distances: &[f32],
    ) -> Result<Self, StraightError> {
        let spawned = Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let mut child = spawned.map_err(StraightError::Program)?;
        let output = child.stdout.take().expect("its output is piped");
        let mut straight = Self { input: child.stdin.take(), output, child, packets: 0, _folder: folder };
        let bytes: Vec<u8> = points.iter().flat_map(|number| number.to_ne_bytes()).collect();
        straight.send(&bytes)?;
        straight.packets = u32::from_ne_bytes(straight.receive()?);
        let mut differing = 0;
        for distance in distances {
            let straight = f32::from_ne_bytes(straight.receive()?);
            // The sign of a zero is not defined.
            differing += usize::from((straight + 0.0).to_bits() != (distance + 0.0).to_bits());
        }
        if differing > 0 { Err(StraightError::Differs(differing)) } else { Ok(straight) }
    }

    /// Evaluates the points again and again for about this time.
    fn points_per_second(&mut self, time: Duration) -> Result<f64, StraightError> {
        self.send(&time.as_secs_f64().to_ne_bytes())?;
        Ok(f64::from_ne_bytes(self.receive()?))
    }

    /// Compares its rates with the evaluator's, round by round.
    fn report(&self, rates: &[f64], straight_rates: &[f64]) -> StraightReport {
        StraightReport {
            points_per_second: Spread::new(straight_rates.to_vec()).median,
            packets: self.packets,
            ratio: Spread::new(rates.iter().zip(straight_rates).map(|(rate, straight)| rate / straight).collect()),
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), StraightError> {
        self.input.as_mut().expect("it is open until the end").write_all(bytes).map_err(StraightError::Program)
    }

    fn receive<const N: usize>(&mut self) -> Result<[u8; N], StraightError> {
        let mut bytes = [0; N];
        self.output.read_exact(&mut bytes).map_err(StraightError::Program)?;
        Ok(bytes)
    }
}

impl Drop for Straight {
    /// The program ends when its input does.
    fn drop(&mut self) {
        self.input = None;
        let _ = self.child.wait();
    }
}

/// The program's source. The scene's numbers are constants, as one who writes this scene's distance by hand would have
/// them.
fn source(tape: &Tape) -> Result<String, StraightError> {
    if tape.flops_per_call(DISTANCE).is_none() {
        return Err(StraightError::Loops);
    }
    let mut parts = Vec::new();
    let mut rest = TEMPLATE;
    for mark in MARKS {
        let (part, after) = rest.split_once(mark).expect("straight.cpp has all marks");
        parts.push(part);
        rest = after;
    }
    let (code, before, packets, evaluate) = (tape.to_packet_c()?.code, parts[0], parts[1], parts[2]);
    // C++ has no arrays of no numbers.
    let uniforms = tape.uniforms().iter().chain(&[0]);
    let uniforms: Vec<String> = uniforms.map(|bits| format!("FLOAT({bits:#010x}u)")).collect();
    let mut text = format!("constexpr int POINTS = {POINTS};\n{before}");
    let _ = writeln!(text, "static constexpr float uniforms[] = {{ {} }};\n", uniforms.join(", "));
    for count in PACKETS {
        let _ = writeln!(
            text,
            "namespace packets_{count} {{\nconstexpr int PACKETS = {count};\n{packets}{code}{evaluate}}}\n"
        );
    }
    Ok(text + rest)
}

fn compile(text: &str, options: &[&str], folder: &Path) -> Result<PathBuf, StraightError> {
    let (source, program) = (folder.join("straight.cpp"), folder.join("straight"));
    std::fs::write(&source, text).map_err(StraightError::Program)?;
    let compiler = std::env::var_os("CXX").unwrap_or_else(|| "c++".into());
    let output = Command::new(&compiler)
        .args(["-std=c++17", "-O3", "-mfma", "-mtune=native", "-ffp-contract=off"])
        .args(options)
        .arg("-o")
        .args([&program, &source])
        .output();
    match output {
        Ok(output) if output.status.success() => Ok(program),
        Ok(output) => {
            Err(StraightError::Compiler { compiler, message: String::from_utf8_lossy(&output.stderr).into_owned() })
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(StraightError::NoCompiler),
        Err(error) => Err(StraightError::Compiler { compiler, message: error.to_string() }),
    }
}

#[cfg(test)]
mod tests;
