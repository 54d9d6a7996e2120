//! Memory for tests: its neighbors are pages that can't be touched, so code that leaves it ends the process.

use memmap2::MmapMut;
use rustix::mm::{MprotectFlags, mprotect};

use super::memory::Memory;
use super::{Frame, Packet, Program, Uniforms};
use crate::tape::Tape;

/// Edge at which memory lies next to a page that can't be touched.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Edge {
    Start,
    End,
}

/// Pages with content, between two that can't be touched.
#[derive(Debug)]
pub(super) struct Pages {
    map: MmapMut,
    begin: usize,
    bytes: usize,
}

impl Pages {
    /// Pages; this number of bytes, the begin of these packets, can be touched at one edge.
    pub(super) fn new(packets: &[Packet], bytes: usize, edge: Edge) -> Self {
        let page = rustix::param::page_size();
        let inside = bytes.next_multiple_of(page);
        let mut map = MmapMut::map_anon(page + inside + page).expect("memory");
        let begin = match edge {
            Edge::Start => page,
            Edge::End => page + inside - bytes,
        };
        let content = packets.iter().flat_map(|packet| packet.0).flat_map(f32::to_ne_bytes);
        map[begin..begin + bytes].iter_mut().zip(content).for_each(|(to, from)| *to = from);
        for guard in [0, page + inside] {
            let address = map[guard..].as_mut_ptr();
            #[expect(unsafe_code, reason = "takes away the access to a page")]
            // SAFETY: the page belongs to the mapping, and nothing here refers to it.
            let protected = unsafe { mprotect(address.cast(), page, MprotectFlags::empty()) };
            protected.expect("pages can be protected");
        }
        Self { map, begin, bytes }
    }

    pub(super) fn address(&self) -> *const u8 {
        self.map[self.begin..].as_ptr()
    }

    pub(super) fn packets(&mut self) -> &mut [Packet] {
        let bytes = &mut self.map[self.begin..self.begin + self.bytes];
        #[expect(unsafe_code, reason = "gives bytes a type")]
        // SAFETY: all bits are numbers.
        let (before, packets, after) = unsafe { bytes.align_to_mut() };
        assert!(before.is_empty() && after.is_empty(), "whole packets");
        packets
    }

    /// Rows of numbers.
    fn numbers(&mut self) -> &mut [f32] {
        let bytes = &mut self.map[self.begin..self.begin + self.bytes];
        #[expect(unsafe_code, reason = "gives bytes a type")]
        // SAFETY: all bits are numbers.
        let (before, numbers, after) = unsafe { bytes.align_to_mut() };
        assert!(before.is_empty() && after.is_empty(), "whole numbers");
        numbers
    }

    /// A copy of rows of numbers.
    fn rows(numbers: &[f32], edge: Edge) -> Self {
        let mut pages = Self::new(&[], size_of_val(numbers), edge);
        pages.numbers().copy_from_slice(numbers);
        pages
    }
}

impl Program {
    /// The same program, with its constants at an edge.
    pub(crate) fn guarded(self, edge: Edge) -> Self {
        Self { constants: self.constants.guarded(edge), ..self }
    }

    /// Memory to run it in, at an edge.
    pub(crate) fn guarded_frame(&self, edge: Edge) -> Frame {
        Frame(self.frame().0.guarded(edge))
    }

    /// Values of the uniforms, at an edge.
    pub(crate) fn guarded_uniforms(&self, tape: &Tape, edge: Edge) -> Uniforms {
        let Uniforms { numbers, table } = self.uniforms(tape.uniforms(), tape.table().cloned());
        Uniforms { numbers: numbers.guarded(edge), table }
    }
}

/// Whether a touch of the guarding page is fatal, and of the memory is not.
#[cfg(target_os = "linux")]
#[test]
fn guarded_memory_ends_where_it_should() {
    use std::os::unix::process::ExitStatusExt;
    use std::process::Command;

    const OFFSET: &str = "SDFARM_TEST_TOUCHED_OFFSET";
    const BYTES: usize = 3 * size_of::<Packet>();
    let touch = |edge: Edge, offset: isize| {
        let memory = Memory::zeroed(3).guarded(edge);
        #[expect(unsafe_code, reason = "touches a page that can't be touched")]
        // SAFETY: inside of the memory it is valid; outside, the process ends, as is expected.
        let byte = unsafe { memory.address().cast::<u8>().offset(offset).read_volatile() };
        assert_eq!(byte, 0);
    };
    if let Ok(wanted) = std::env::var(OFFSET) {
        let (edge, offset) = wanted.split_once(' ').expect("an edge and an offset");
        return touch(if edge == "start" { Edge::Start } else { Edge::End }, offset.parse().expect("an offset"));
    }
    let (last, end) = ((BYTES - 1).to_string(), BYTES.to_string());
    for (edge, offset, is_inside) in
        [("start", "0", true), ("start", "-1", false), ("end", last.as_str(), true), ("end", end.as_str(), false)]
    {
        let mut again = Command::new(std::env::current_exe().expect("this test"));
        let name = "x86::program::guarded::guarded_memory_ends_where_it_should";
        let ended = again.args(["--exact", name]).env(OFFSET, format!("{edge} {offset}")).output().expect("it runs");
        assert_eq!(ended.status.success(), is_inside, "byte {offset} at the {edge}: {ended:?}");
        assert_eq!(ended.status.signal().is_some(), !is_inside, "byte {offset} at the {edge}: {ended:?}");
    }
}

mod tests {
    use std::path::PathBuf;
    use std::sync::atomic::AtomicBool;

    use scene::cells::ScalarBuilder;
    use scene::{ImageSpec, Layer};

    use super::{Edge, Pages};
    use crate::picture_tape::{ACCUMULATE, LAYERS, MEAN, record_picture};
    use crate::random_formula::{Generator, random_formula};
    use crate::tape::{Expr, LinearTape, Tape, record};
    use crate::x86::{AVX2, AVX512, compile};

    const ALL_LAYERS: [Layer; 9] = [
        Layer::Depth,
        Layer::Normal,
        Layer::Albedo,
        Layer::Object,
        Layer::Position,
        Layer::Steps,
        Layer::Motion,
        Layer::CryptoObject,
        Layer::CryptoMaterial,
    ];

    /// Runs an entry on two packets, on the heap and at both edges of guarded memory; all results must be equal.
    fn assert_inside(name: &str, tape: &Tape, entry: &str, arguments: &[f32]) {
        let linear = LinearTape::new(tape).expect("a recorded tape is valid");
        let cancel = AtomicBool::new(false);
        for isa in [&AVX512, &AVX2].into_iter().filter(|isa| isa.is_available()) {
            let program = compile(&linear, isa).expect("it is available");
            let lanes = 2 * program.lanes();
            let (_, signature) = program.entries.iter().find(|(name, _)| *name == entry).expect("an entry of the tape");
            let results = signature.results;
            let rows: Vec<f32> =
                arguments.iter().flat_map(|&first| (0..lanes).map(move |lane| first + lane as f32 / 8.0)).collect();
            let mut want = vec![0.0; results * lanes];
            let (mut frame, uniforms) = (program.frame(), program.uniforms(tape.uniforms(), tape.table().cloned()));
            program.run(entry, &mut frame, &uniforms, &cancel, &rows, &mut want);
            for edge in [Edge::Start, Edge::End] {
                let program = compile(&linear, isa).expect("it is available").guarded(edge);
                let (mut frame, uniforms) = (program.guarded_frame(edge), program.guarded_uniforms(tape, edge));
                let (mut rows, mut got) = (Pages::rows(&rows, edge), Pages::rows(&vec![0.0; results * lanes], edge));
                program.run(entry, &mut frame, &uniforms, &cancel, rows.numbers(), got.numbers());
                let bits = |numbers: &[f32]| numbers.iter().map(|number| number.to_bits()).collect::<Vec<u32>>();
                assert_eq!(bits(got.numbers()), bits(&want), "{entry} of {name} with {lanes} lanes at the {edge:?}");
            }
        }
    }

    fn scenes() -> Vec<PathBuf> {
        let root = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes"));
        let files = [root.clone(), root.join("paper")].into_iter().flat_map(|folder| {
            std::fs::read_dir(folder).expect("the scenes are there").map(|entry| entry.expect("it can be read").path())
        });
        let mut files: Vec<PathBuf> =
            files.filter(|path| path.extension().is_some_and(|extension| extension == "json")).collect();
        files.sort();
        files
    }

    #[test]
    fn every_shipped_scene_stays_in_its_memory() {
        let paths = scenes();
        assert!(paths.len() > 30, "{} scenes", paths.len());
        for path in paths {
            let job = scene::parse(&std::fs::read(&path).expect("a job file")).expect("a valid job");
            let image = ImageSpec { samples: 2.into(), layers: ALL_LAYERS.to_vec(), ..job.image.clone() };
            let (x, y) = (image.width as f32 / 2.0, image.height as f32 / 2.0);
            let job = job.with_image(image);
            let tape = record_picture(&job.at(0).expect("a valid frame"), &ScalarBuilder);
            let name = path.display().to_string();
            let channels = job.image.film().sum_channels();
            assert_inside(&name, &tape, ACCUMULATE, &[vec![x, y, 0.0, 1.0], vec![0.0; channels]].concat());
            let sums: Vec<f32> = [0.5, 0.25, 2.0, 1.0].into_iter().cycle().take(channels).collect();
            assert_inside(&name, &tape, MEAN, &sums);
            assert_inside(&name, &tape, LAYERS, &[x, y]);
        }
    }

    #[test]
    fn random_formulas_stay_in_their_memory() {
        for seed in 0..300 {
            let depth = (seed % 4) as usize;
            let formula = |all: [Expr; 3]| vec![random_formula(&mut Generator(seed), &all, depth)];
            let tape = record(|recording| recording.entry("formula", formula));
            assert_inside(&format!("formula {seed}"), &tape, "formula", &[-1.5, 0.25, 1.0]);
        }
    }
}
