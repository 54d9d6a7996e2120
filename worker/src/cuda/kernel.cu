// Code around the generated steps of a picture: exact arithmetic, and the mapping from a thread to its pixel.
// It has no formula of a picture.
//
// The host's compiler takes the same source; there the arithmetic is the C library's, which is exact too.

#ifdef __CUDACC_RTC__

#define INLINE_FN static __device__ __forceinline__
#define NOINLINE_FN static __device__ __noinline__
#define INLINE_METHOD __device__ __forceinline__

// Constant memory holds 64 KiB.
#if UNIFORM_COUNT <= 16384
__constant__ float uniforms[UNIFORM_COUNT];
#else
__device__ float uniforms[UNIFORM_COUNT];
#endif

// Words of the scene that are read by computed indices.
__device__ const unsigned* table;
INLINE_FN unsigned word_at(unsigned index, unsigned last) { return __ldg(table + min(index, last)); }
INLINE_FN unsigned word_of_row(unsigned row, unsigned place) { return __ldg(table + row + place); }
__device__ unsigned* asked;
INLINE_FN unsigned fetch_or(unsigned* word, unsigned bits) { return atomicOr(word, bits); }
INLINE_FN unsigned fetch_add(unsigned* word, unsigned by) { return atomicAdd(word, by); }
// Copies of a loop's body may cost more than the loop.
#define ONE_COPY _Pragma("unroll 1")
#define UNROLL _Pragma("unroll")

INLINE_FN unsigned bits_of(float x) { return __float_as_uint(x); }
INLINE_FN float float_from_bits(unsigned bits) { return __uint_as_float(bits); }
INLINE_FN float fma_rn(float a, float b, float c) { return __fmaf_rn(a, b, c); }

// Correctly rounded for x from 1e-28 to 1e37, without a branch: the approximate reciprocal root,
// and one step of Newton's method whose error is computed exactly (Peter Markstein, "IA-64 and
// Elementary Functions", 2000). Below, 0 by definition.
INLINE_FN float sqrt_rn(float x) {
    float r;
    asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(x));
    const float g = x * r, h = 0.5f * r;
    return x < 1e-28f ? 0.0f : fma_rn(fma_rn(-g, g, x), h, g);
}

// Correctly rounded by the same method, if the divisor's magnitude is from 2^-100 to 2^100 and neither the
// quotient nor a/2^24 is below 2^-126, or if a is 0.
INLINE_FN float div_rn(float a, float b) {
    float r;
    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(b));
    r = fma_rn(r, fma_rn(-b, r, 1.0f), r);
    const float q = a * r;
    return fma_rn(fma_rn(-b, q, a), r, q);
}

INLINE_FN float min_f(float a, float b) { return fminf(a, b); }
INLINE_FN float max_f(float a, float b) { return fmaxf(a, b); }
INLINE_FN float abs_f(float x) { return fabsf(x); }
INLINE_FN float floor_f(float x) { return floorf(x); }

INLINE_FN float from_lane(float x, unsigned lane) { return __shfl_sync(~0u, x, lane); }

// The threads that are together here, and how many of them meet a condition.
INLINE_FN unsigned threads_together() { return __activemask(); }
INLINE_FN unsigned count_of(unsigned threads, bool condition) { return __popc(__ballot_sync(threads, condition)); }

#else

#include <math.h>
#include <string.h>

#define INLINE_FN static inline
#define NOINLINE_FN static
#define INLINE_METHOD inline
#define __global__
#define __restrict__

struct Index { unsigned x, y, z; };
static Index blockIdx, blockDim, threadIdx;
static float uniforms[UNIFORM_COUNT];
static const unsigned* table;

INLINE_FN unsigned word_at(unsigned index, unsigned last) { return table[index < last ? index : last]; }
INLINE_FN unsigned word_of_row(unsigned row, unsigned place) { return table[row + place]; }
static unsigned* asked;
INLINE_FN unsigned fetch_or(unsigned* word, unsigned bits) { const unsigned old = *word; *word |= bits; return old; }
INLINE_FN unsigned fetch_add(unsigned* word, unsigned by) { const unsigned old = *word; *word += by; return old; }
#define ONE_COPY
#define UNROLL
INLINE_FN unsigned bits_of(float x) { unsigned bits; memcpy(&bits, &x, 4); return bits; }
INLINE_FN float float_from_bits(unsigned bits) { float x; memcpy(&x, &bits, 4); return x; }
INLINE_FN float fma_rn(float a, float b, float c) { return fmaf(a, b, c); }
INLINE_FN float sqrt_rn(float x) { return x < 1e-28f ? 0.0f : sqrtf(x); }
INLINE_FN float div_rn(float a, float b) { return a / b; }
INLINE_FN float min_f(float a, float b) { return b < a ? b : a; }
INLINE_FN float max_f(float a, float b) { return a < b ? b : a; }
INLINE_FN float abs_f(float x) { return fabsf(x); }
INLINE_FN float floor_f(float x) { return floorf(x); }

// A thread of the host has no warp: it renders all samples of its pixel.
#undef TOGETHER
#define TOGETHER 1u
INLINE_FN float from_lane(float x, unsigned) { return x; }
INLINE_FN unsigned threads_together() { return 1u; }
INLINE_FN unsigned count_of(unsigned, bool condition) { return condition; }

#endif

// Asks the host for the cell of a missing word, and returns a word in place of it. Without memory for that, no word is
// missing. The memory: the number of cells that were asked for, the number of cells that it holds, their indices, the
// lengths of their lists, and a bit for each word of the table that tells whether its cell is among them.
NOINLINE_FN unsigned made_word(unsigned missing, unsigned index_mask, unsigned length_place, unsigned stand_in) {
    if (!asked) return missing;
    const unsigned index = missing & index_mask, bit = 1u << index % 32, room = asked[1];
    unsigned* bits = asked + 2 + 2 * room + index / 32;
    if (!(*(volatile unsigned*)bits & bit) && !(fetch_or(bits, bit) & bit)) {
        const unsigned turn = fetch_add(asked, 1u);
        if (turn < room) {
            asked[2 + turn] = index;
            asked[2 + room + turn] = table[index + length_place];
        }
    }
    return stand_in;
}

// ---- the picture ----

// Rectangle of pixels, with its blocks of threads and its offset in the result.
struct Tile {
    unsigned x, y, width, height;
    // Number of blocks of all earlier tiles; blocks per row of this tile.
    unsigned first_block, columns;
    // Index of its first number in the result, and distances there from one row and from one plane to the next.
    unsigned long long start, pitch, plane;
};

struct Pixel {
    float x, y;
    // Index in the result, and distance from one plane to the next.
    unsigned long long offset, stride;
    bool is_inside;
};

// Each launch takes groups of blocks from all parts of the picture, so that launches cost about the same;
// blocks of a group are neighbors and take similar branches.
struct Blocks {
    const unsigned* groups;
    unsigned first;
    // Pixels of a block.
    unsigned columns, rows;
};

// The pixel of a block's thread with this index.
INLINE_FN Pixel pixel_of(const Tile* tiles, unsigned tile_count, const Blocks& blocks, unsigned index) {
    const unsigned launch_index = blocks.first + blockIdx.x;
    const unsigned block = blocks.groups[launch_index / BLOCK_GROUP] * BLOCK_GROUP + launch_index % BLOCK_GROUP;
    // The last tile that starts at this block or before it.
    unsigned low = 0, high = tile_count;
    while (high - low > 1) {
        const unsigned middle = (low + high) / 2;
        if (tiles[middle].first_block <= block) low = middle;
        else high = middle;
    }
    const Tile tile = tiles[low];
    const unsigned own = block - tile.first_block;
    const unsigned column = own % tile.columns * blocks.columns + index % blocks.columns;
    const unsigned row = own / tile.columns * blocks.rows + index / blocks.columns;
    Pixel pixel;
    pixel.x = (float)(tile.x + column);
    pixel.y = (float)(tile.y + row);
    pixel.stride = tile.plane;
    pixel.offset = tile.start + row * tile.pitch + column;
    // The last group may have blocks that are in no tile.
    pixel.is_inside = column < tile.width && row < tile.height && index < blocks.columns * blocks.rows;
    return pixel;
}

struct Sum {
    float red, green, blue, alpha;
#ifdef PART_PLANES
    // Light by light groups and by brightness.
    float parts[PART_PLANES];
#endif
};

INLINE_FN Sum operator+(const Sum& a, const Sum& b) {
    Sum sum = { a.red + b.red, a.green + b.green, a.blue + b.blue, a.alpha + b.alpha };
#ifdef PART_PLANES
    UNROLL for (unsigned plane = 0; plane < PART_PLANES; ++plane) sum.parts[plane] = a.parts[plane] + b.parts[plane];
#endif
    return sum;
}

// A pixel's sum in the planes from `plane` on.
INLINE_FN Sum read_sum(const Pixel& pixel, unsigned plane, const float* out) {
    const float* red = out + pixel.offset + plane * pixel.stride;
    Sum sum = { *red, red[pixel.stride], red[2 * pixel.stride], red[3 * pixel.stride] };
#ifdef PART_PLANES
    UNROLL for (unsigned plane = 0; plane < PART_PLANES; ++plane) sum.parts[plane] = red[(4 + plane) * pixel.stride];
#endif
    return sum;
}

INLINE_FN void store_sum(const Sum& sum, const Pixel& pixel, unsigned plane, float* out) {
    float* red = out + pixel.offset + plane * pixel.stride;
    *red = sum.red;
    red[pixel.stride] = sum.green;
    red[2 * pixel.stride] = sum.blue;
    red[3 * pixel.stride] = sum.alpha;
#ifdef PART_PLANES
    UNROLL for (unsigned plane = 0; plane < PART_PLANES; ++plane) red[(4 + plane) * pixel.stride] = sum.parts[plane];
#endif
}

// The sum of the samples before `first` in its batch.
INLINE_FN Sum sum_before(float first, const Pixel& pixel, const float* out) {
    if ((unsigned)first % BATCH == 0u) return { 0.0f, 0.0f, 0.0f, 0.0f };
    return read_sum(pixel, 0u, out);
}

// Writes a pixel's sum in the batch of its samples from `first` until before `end`, and that of the batches before; or the
// mean of all if that was the last of its samples.
INLINE_FN void write_sum(Sum sum, float first, float end, unsigned is_last, const Pixel& pixel, float* out) {
#ifdef BATCHES_PLANE
    const Sum none = { 0.0f, 0.0f, 0.0f, 0.0f };
    Sum batches = first < (float)BATCH ? none : read_sum(pixel, BATCHES_PLANE, out);
    if (is_last) {
        sum = batches + sum;
    } else {
        if ((unsigned)end % BATCH == 0u) {
            batches = batches + sum;
            sum = none;
        }
        store_sum(batches, pixel, BATCHES_PLANE, out);
    }
#endif
    if (is_last) {
        const mean_result mean = step_mean(sum.red, sum.green, sum.blue, sum.alpha PARTS_OF(sum));
        // A file must not distinguish zeros by their sign.
        sum = { mean.f0 + 0.0f, mean.f1 + 0.0f, mean.f2 + 0.0f, mean.f3 + 0.0f PARTS_FROM(mean, + 0.0f) };
    }
    store_sum(sum, pixel, 0u, out);
}

#ifdef AOV_PLANES
// Writes the layers' planes, after the planes of light.
extern "C" __global__ void layers(const Tile* __restrict__ tiles, unsigned tile_count, Blocks blocks,
                                  float* __restrict__ out) {
    const Pixel pixel = pixel_of(tiles, tile_count, blocks, threadIdx.x);
    if (!pixel.is_inside) return;
    const layers_result seen = step_layers(pixel.x, pixel.y);
    write_layers(seen, out + pixel.offset + LIGHT_PLANES * pixel.stride, pixel.stride);
}
#endif
