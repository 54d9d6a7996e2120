//! Limits of a job. Exceeding one is an error that names it, never a crash.

/// Bytes of a job file.
pub const MAX_BODY_BYTES: usize = 8 << 20;
/// Nesting of JSON arrays and objects, checked before parsing.
pub const MAX_JSON_DEPTH: usize = 256;
/// Nesting of nodes.
pub const MAX_NODE_DEPTH: usize = 64;
/// Nodes of a scene.
pub const MAX_NODES: usize = 100_000;
/// Materials in use in a scene.
pub const MAX_MATERIALS: usize = 1_024;
/// Lights of a scene.
pub const MAX_LIGHTS: usize = 64;
/// Pixels of a frame.
pub const MAX_PIXELS: u64 = 1 << 28;
/// Pixels of a picture's edge.
pub const MAX_EDGE_PX: u32 = 65_535;
/// Rays a pixel.
pub const MAX_SAMPLES: u32 = 65_536;
/// Frames of a job.
pub const MAX_FRAMES: u32 = 100_000;
/// Camera rays of a job.
pub const MAX_RAYS: u64 = 1 << 44;
/// Characters of a name.
pub const MAX_NAME_CHARS: usize = 200;
/// Steps of one ray.
pub const MAX_STEPS: u32 = 65_536;
/// Steps of a ray through a cloud or a volume.
pub const MAX_MEDIUM_STEPS: u32 = 1_024;
/// Steps of a ray through a volume toward a light.
pub const MAX_LIGHT_STEPS: u32 = 64;
/// Times that a ray is mirrored or refracted.
pub const MAX_BOUNCES: u32 = 32;
/// Largest coordinate or length, in scene units.
pub const MAX_LENGTH: f32 = 1e6;
/// Smallest size, in scene units.
pub const MIN_LENGTH: f32 = 1e-6;
/// Iterations of a fractal.
pub const MAX_ITERATIONS: u32 = 64;
/// Keys of a track.
pub const MAX_KEYFRAMES: usize = 10_000;
/// Seconds of a key, before or after frame 0.
pub const MAX_KEYFRAME_SECONDS: f64 = 1e9;
/// Bytes of a job that moves, times its frames, up to which every frame is looked over when it is handed in.
pub const MAX_FULL_CHECK_BYTES: u64 = 1 << 30;
/// Frames of a longer one that are.
pub const MIN_SAMPLED_FRAMES: u32 = 16;
/// Textures in the colors of textures.
pub const MAX_TEXTURE_DEPTH: usize = 4;
/// Stops of a color ramp.
pub const MAX_RAMP_STOPS: usize = 32;
