//! Size of a job, counted, and its time and memory, estimated from a sample.

use proto::preview_helper::CostSample;
use proto::tile::Tiling;
use scene::{Bits, Film, Format, ImageSpec, Job, Precision, SampleCount};
use serde_json::{Value, json};

/// Number of server cores that render as fast as one H200: it takes 0.40 ms for `five-spheres`, and 16 cores take
/// 20.5 ms
/// (docs/benchmarks.md).
pub(crate) const CORES_OF_AN_H200: f64 = 800.0;
/// Maximum bytes of a picture's file in addition to its pixels.
const FILE_HEAD_BYTES: u64 = 64 << 10;

/// Size of a job, and its estimate.
#[derive(Debug)]
pub(super) struct Outlook {
    nodes: u32,
    objects: usize,
    materials: usize,
    lights: usize,
    image: ImageSpec,
    frames: u32,
    rays: u64,
    tiles: u64,
    /// Memory for the pixels of a frame while it is rendered.
    frame_bytes: u64,
    /// Maximum size of a frame's file.
    file_bytes: u64,
    threads: usize,
    judged: Option<Judged>,
}

/// Estimate from a sample.
#[derive(Clone, Copy, Debug)]
struct Judged {
    core_seconds: f64,
    /// Range of the time of one core.
    range: (f64, f64),
    memory_bytes: u64,
    sample_rays: u64,
}

impl Outlook {
    /// Outlook of a job on `threads` threads; without a sample its time is unknown.
    pub(super) fn new(job: &Job, threads: usize, sample: Option<&CostSample>) -> Self {
        let film = job.image.film();
        let (width, height, samples) = (film.width, film.height, job.image.samples.max());
        let frames = u64::from(job.frames.count);
        let tiling = Tiling { width, height, samples, pixel_bytes: film.pixel_bytes(), tile_edge: None };
        let (rays, tiles) = (job.rays_per_frame() * frames, tiling.tiles().len() as u64 * frames);
        let judge = |sample: &CostSample| {
            let core_seconds = sample.core_seconds(rays, tiles, frames, film.pixels() * frames);
            let range = sample.range(core_seconds);
            Judged { core_seconds, range, memory_bytes: sample.memory_bytes, sample_rays: sample.rays }
        };
        Self {
            nodes: job.nodes(),
            objects: job.scene.objects.len(),
            materials: job.scene.used_materials().len(),
            lights: job.scene.lights.len(),
            frames: job.frames.count,
            rays,
            tiles,
            frame_bytes: film.pixels() * u64::from(film.pixel_bytes()),
            file_bytes: film.pixels() * file_pixel_bytes(&job.image) + u64::from(height) * 16 + FILE_HEAD_BYTES,
            threads,
            judged: sample.map(judge),
            image: job.image.clone(),
        }
    }

    /// Formats the outlook as lines for users.
    pub(super) fn lines(&self) -> Vec<String> {
        let Film { width, height, .. } = self.image.film();
        let (samples, most) = match &self.image.samples {
            SampleCount::Fixed(samples) => (count(u64::from(*samples), "sample"), ""),
            SampleCount::Adaptive(adaptive) => (format!("{} to {} samples", adaptive.min, adaptive.max), "at most "),
        };
        let mut lines = vec![
            format!(
                "scene: {} in {}, {}, {}",
                count(u64::from(self.nodes), "node"),
                count(self.objects as u64, "object"),
                count(self.materials as u64, "material"),
                count(self.lights as u64, "light")
            ),
            format!("pictures: {} of {width}×{height}, {samples} a pixel", count(u64::from(self.frames), "frame")),
            format!("work: {most}{} in {}", count(self.rays, "camera ray"), count(self.tiles, "tile")),
        ];
        lines.push(match self.judged {
            Some(Judged { core_seconds, range: (low, high), sample_rays, .. }) => format!(
                "time: {most}about {} of one core (from {} to {}), {} on the {} of this machine, {} on an H200; estimated from {}",
                duration(core_seconds),
                duration(low),
                duration(high),
                duration(self.seconds_here(core_seconds)),
                count(self.threads as u64, "core"),
                duration(core_seconds / CORES_OF_AN_H200),
                count(sample_rays, "ray")
            ),
            None => "time: unknown, because not even a small sample was rendered in time".to_owned(),
        });
        let memory = self.judged.map(|judged| format!("about {}; ", bytes(judged.memory_bytes))).unwrap_or_default();
        lines.push(format!(
            "memory: {memory}{} for the pixels of a frame, {} for its file at most",
            bytes(self.frame_bytes),
            bytes(self.file_bytes)
        ));
        lines
    }

    /// Formats the outlook as JSON, with the job's warnings.
    pub(super) fn json(&self, warnings: &[String]) -> Value {
        let estimate = self.judged.map(|Judged { core_seconds, range: (low, high), memory_bytes, sample_rays }| {
            json!({
                "core_seconds": tidy(core_seconds),
                "core_seconds_low": tidy(low),
                "core_seconds_high": tidy(high),
                "seconds_on_this_machine": tidy(self.seconds_here(core_seconds)),
                "cores_of_this_machine": self.threads,
                "seconds_on_an_h200": tidy(core_seconds / CORES_OF_AN_H200),
                "memory_bytes": memory_bytes,
                "sample_rays": sample_rays,
            })
        });
        json!({
            "valid": true,
            "warnings": warnings,
            "nodes": self.nodes,
            "objects": self.objects,
            "materials": self.materials,
            "lights": self.lights,
            "width": self.image.film().width,
            "height": self.image.film().height,
            "samples": self.image.samples,
            "frames": self.frames,
            "rays": self.rays,
            "tiles": self.tiles,
            "frame_bytes": self.frame_bytes,
            "max_file_bytes": self.file_bytes,
            "estimate": estimate,
        })
    }

    fn seconds_here(&self, core_seconds: f64) -> f64 {
        core_seconds / self.threads.max(1) as f64
    }
}

/// Bytes of a pixel in its file without compression.
fn file_pixel_bytes(image: &ImageSpec) -> u64 {
    let channels = image.film().channels().len() as u64;
    match (image.format, image.bits, image.precision) {
        (Format::Png, Bits::Eight, _) => 4,
        (Format::Png, Bits::Sixteen, _) => 8,
        // Layers are 32-bit numbers; colors have the job's depth.
        (Format::Exr, _, Precision::Half) => 4 * 2 + (channels - 4) * 4,
        (Format::Exr, _, Precision::Float) => channels * 4,
    }
}

/// "1 frame", "2 frames", "2,073,600 camera rays".
pub(crate) fn count(number: u64, noun: &str) -> String {
    let ending = if number == 1 { "" } else { "s" };
    format!("{} {noun}{ending}", grouped(number))
}

/// Formats a number with commas between thousands.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut grouped = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    grouped
}

/// Rounds a number to two significant digits.
fn tidy(number: f64) -> f64 {
    format!("{number:.1e}").parse().unwrap_or(number)
}

/// Formats seconds for users: "0.4 ms", "2.5 s", "3 min", "4 h 10 min", "12 days".
pub(crate) fn duration(seconds: f64) -> String {
    let whole = |seconds: f64| seconds.round() as u64;
    match seconds {
        s if s < 0.000_95 => "less than 1 ms".to_owned(),
        s if s < 0.95 => format!("{} ms", tidy(s * 1000.0)),
        s if s < 99.5 => format!("{} s", tidy(s)),
        s if s < 5400.0 => format!("{} min", whole(s / 60.0)),
        s if s < 172_800.0 => format!("{} h {} min", whole(s) / 3600, whole(s) % 3600 / 60),
        s => count(whole(s / 86_400.0), "day"),
    }
}

/// Formats bytes for users.
fn bytes(bytes: u64) -> String {
    match bytes as f64 {
        b if b < 9_950_000.0 => format!("{} MB", tidy(b / 1e6)),
        b if b < 999_500_000.0 => format!("{:.0} MB", b / 1e6),
        b => format!("{:.1} GB", b / 1e9),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_formatted_for_users() {
        assert_eq!(count(1, "frame"), "1 frame");
        assert_eq!(count(1_234_567, "ray"), "1,234,567 rays");
        let formatted = [0.0, 0.0123, 0.5, 2.345, 61.0, 400.0, 9000.0, 1e6].map(duration);
        assert_eq!(formatted, ["less than 1 ms", "12 ms", "500 ms", "2.3 s", "61 s", "7 min", "2 h 30 min", "12 days"]);
        assert_eq!([1_000, 33_177_600, 5_000_000_000].map(bytes), ["0.001 MB", "33 MB", "5.0 GB"]);
    }

    #[test]
    fn size_is_counted_and_time_is_estimated() {
        let job = scene::parse(
            br#"{ "scene": { "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
                "objects": [{ "shape": { "sphere": { "radius": 1 } } }] },
                "image": { "width": 64, "height": 32, "samples": 4 }, "frames": { "count": 2 } }"#,
        )
        .expect("a valid job");
        let sample = CostSample {
            rays: 10,
            thread_seconds_per_ray: 1e-3,
            setup_seconds_per_tile: 0.0,
            shared_seconds_per_frame: 0.0,
            encode_seconds_per_pixel: 0.0,
            relative_error: 0.1,
            memory_bytes: 20_000_000,
        };
        let outlook = Outlook::new(&job, 2, Some(&sample));
        let value = outlook.json(&[]);
        assert_eq!(
            (value["nodes"].as_u64(), value["rays"].as_u64(), value["tiles"].as_u64()),
            (Some(1), Some(16384), Some(2))
        );
        assert_eq!(value["estimate"]["seconds_on_this_machine"], 8.2);
        assert_eq!(value["frame_bytes"], 64 * 32 * 16);
        let lines = outlook.lines().join("\n");
        assert!(lines.contains("1 node in 1 object, 1 material, 1 light"), "{lines}");
        assert!(lines.contains("2 frames of 64×32, 4 samples a pixel"), "{lines}");
        assert!(lines.contains("about 16 s of one core (from 15 s to 18 s), 8.2 s on the 2 cores"), "{lines}");
        assert!(Outlook::new(&job, 2, None).lines().join("\n").contains("time: unknown"));
    }
}
