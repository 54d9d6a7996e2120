//! Limits of a job. Exceeding one is an error that names it, never a crash.

/// Maximum bytes of a job file.
pub const MAX_BODY_BYTES: usize = 32 << 20;
/// Maximum nesting of JSON arrays and objects, checked before parsing.
pub const MAX_JSON_DEPTH: usize = 256;
/// Maximum bytes of a key, checked before parsing: the pointer of each error in its value has it.
pub const MAX_KEY_BYTES: usize = 4_096;
/// Maximum nesting of groups.
pub const MAX_GROUP_DEPTH: usize = 8;
/// Maximum number of points of a path.
pub(crate) const MAX_PATH_POINTS: usize = 1_000;
/// Maximum nesting of nodes.
pub const MAX_NODE_DEPTH: usize = 64;
/// Maximum number of nodes of a scene.
pub const MAX_NODES: usize = 1_000_000;
/// Maximum number of JSON values of a scene in which each use of a shape is that shape, and each object of a group has
/// the group's motion: 16 for each node that a scene may have.
pub const MAX_VALUES: u64 = 16 * MAX_NODES as u64;
/// Maximum number of scattered copies of a scene, each times the cost of the surface under it in simple nodes.
pub const MAX_PLACING_COST: f32 = 2e6;
/// Maximum number of materials in use in a scene.
pub const MAX_MATERIALS: usize = 1_024;
/// Maximum number of lights of a scene.
pub const MAX_LIGHTS: usize = 64;
/// Maximum number of light groups of a picture.
pub const MAX_LIGHT_GROUPS: usize = 8;
/// Minimum number of samples of each pixel of a picture whose fireflies are reweighted.
pub const MIN_REWEIGHTED_SAMPLES: u32 = 16;
/// Maximum number of times that the light group changes from an object to the next.
pub const MAX_LIGHT_GROUP_RUNS: usize = 256;
/// Maximum number of pixels of a frame.
pub const MAX_PIXELS: u64 = 1 << 28;
/// Maximum width and height of a picture, in pixels.
pub const MAX_EDGE_PX: u32 = 65_535;
/// Maximum number of rays per pixel.
pub const MAX_SAMPLES: u32 = 65_536;
/// Maximum number of frames of a job.
pub const MAX_FRAMES: u32 = 100_000;
/// Maximum number of camera rays of a job.
pub const MAX_RAYS: u64 = 1 << 44;
/// Maximum number of characters of a name.
pub const MAX_NAME_CHARS: usize = 200;
/// Maximum number of steps of one ray.
pub(crate) const MAX_STEPS: u32 = 65_536;
/// Maximum number of steps of a ray through a cloud or a volume.
pub const MAX_MEDIUM_STEPS: u32 = 1_024;
/// Maximum number of steps of a ray through a volume toward a light.
pub(crate) const MAX_LIGHT_STEPS: u32 = 64;
/// Maximum number of reflections and refractions of a ray.
pub(crate) const MAX_BOUNCES: u32 = 32;
/// Largest coordinate or length, in scene units.
pub(crate) const MAX_LENGTH: f32 = 1e6;
/// Smallest size, in scene units.
pub const MIN_LENGTH: f32 = 1e-6;
/// Maximum number of iterations of a fractal.
pub(crate) const MAX_ITERATIONS: u32 = 64;
/// Maximum number of keyframes of a track.
pub(crate) const MAX_KEYFRAMES: usize = 10_000;
/// Maximum time of a keyframe, in seconds before or after frame 0.
pub(crate) const MAX_KEYFRAME_SECONDS: f64 = 1e9;
/// Bytes of an animated job, times its frames, up to which every frame is validated at submission.
pub(crate) const MAX_FULL_CHECK_BYTES: u64 = 1 << 30;
/// Maximum number of instants at which a frame with motion blur is exposed.
pub(crate) const MAX_INSTANTS: u32 = 64;
/// Minimum number of frames validated in larger animated jobs.
pub(crate) const MIN_SAMPLED_FRAMES: u32 = 16;
/// Maximum nesting of textures in the colors of textures.
pub(crate) const MAX_TEXTURE_DEPTH: usize = 4;
/// Maximum number of stops of a color ramp.
pub(crate) const MAX_RAMP_STOPS: usize = 32;
