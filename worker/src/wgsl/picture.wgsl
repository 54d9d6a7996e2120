// Code around the generated steps of an approximate picture: its inputs and outputs, and the mapping from an invocation to
// its pixel. It has no formula of a picture.

struct Dispatch {
    // Rectangle of pixels that is rendered.
    x: u32,
    y: u32,
    width: u32,
    height: u32,
    picture_width: u32,
    // Samples that are added: from the first until before the end. The first, 0, begins the sums.
    first_sample: u32,
    end_sample: u32,
    reserved: u32,
}

@group(0) @binding(0) var<uniform> dispatch: Dispatch;
// Numbers of the scene, by their bits.
@group(0) @binding(1) var<storage, read> numbers: array<u32, NUMBER_COUNT>;
// Words of the scene's table.
@group(0) @binding(2) var<storage, read> words: array<u32>;
// Sums of the samples: linear light, premultiplied by alpha.
@group(0) @binding(3) var<storage, read_write> sums: array<vec4<f32>>;
// Pixels of 8 bits, red in the lowest, with straight alpha.
@group(0) @binding(4) var<storage, read_write> picture: array<u32>;

// WebGPU limits the index to the buffer.
fn word_at(index: u32, last: u32) -> u32 { return words[min(index, last)]; }

// Below, a root is 0 by definition.
fn root_of(x: f32) -> f32 { return select(sqrt(max(x, 1e-28f)), 0.0f, x < 1e-28f); }

// ---- the picture ----

// The levels of a channel are whole after this, from 0 to 255.
fn byte_of(level: f32) -> u32 { return u32(clamp(level, 0.0f, 255.0f)); }

@compute @workgroup_size(8, 8)
fn render(@builtin(global_invocation_id) place: vec3<u32>) {
    if (place.x >= dispatch.width || place.y >= dispatch.height) { return; }
    let column = dispatch.x + place.x;
    let row = dispatch.y + place.y;
    let index = row * dispatch.picture_width + column;
    let x = f32(column);
    let y = f32(row);
    var sum = vec4<f32>();
    if (dispatch.first_sample > 0u) { sum = sums[index]; }
    let added = step_accumulate(x, y, f32(dispatch.first_sample), f32(dispatch.end_sample), sum.x, sum.y, sum.z, sum.w);
    sum = vec4<f32>(added.f0, added.f1, added.f2, added.f3);
    sums[index] = sum;
    let mean = sum / f32(dispatch.end_sample);
    var alpha = 1.0f;
    var light = mean.xyz;
    if (IS_TRANSPARENT) {
        alpha = clamp(mean.w, 0.0f, 1.0f);
        light = select(vec3<f32>(), mean.xyz / max(mean.w, 1e-30f), mean.w > 0.0f);
    }
    let level = step_levels(light.x, light.y, light.z, x, y);
    let color = byte_of(level.f0) | (byte_of(level.f1) << 8u) | (byte_of(level.f2) << 16u);
    picture[index] = color | (byte_of(alpha * 255.0f + 0.5f) << 24u);
}
