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
// Copies of a loop's body cost more than the loop.
#define LISTS_LOOP _Pragma("unroll 1")
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

INLINE_FN unsigned threads_together() { return __activemask(); }
INLINE_FN bool many_go_on(unsigned began, unsigned one_of, bool goes_on) {
    const unsigned left = __popc(__ballot_sync(began, goes_on));
    return left != 0 && one_of * left >= __popc(began);
}

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
#define LISTS_LOOP
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

INLINE_FN unsigned threads_together() { return 1u; }
INLINE_FN bool many_go_on(unsigned, unsigned, bool goes_on) { return goes_on; }

// A thread of the host has no warp: it renders all samples of its pixel.
#undef TOGETHER
#define TOGETHER 1u
INLINE_FN float from_lane(float x, unsigned) { return x; }

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

// A loop of the threads of a warp that began it together. It pauses when less than one of so many of them goes on, so that
// the others need not wait.
struct Pausing {
    unsigned began = threads_together(), turns = 0u;
    bool goes_on = true;
    INLINE_METHOD bool many(unsigned one_of) const { return many_go_on(began, one_of, goes_on); }
};

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

INLINE_FN accumulate_result of_lane(const accumulate_result& x, unsigned lane) {
    return { from_lane(x.f0, lane), from_lane(x.f1, lane), from_lane(x.f2, lane), from_lane(x.f3, lane) };
}

// Adds the samples from `first` until before `end` to the sums in `out` (0 if `first` is 0).
//
// Neighboring threads render TOGETHER samples of a pixel, because these take similar branches: a power of two up to 32
// that divides the number of samples. Each of them adds all samples in their order.
extern "C" __global__ void render(const Tile* __restrict__ tiles, unsigned tile_count, Blocks blocks, float first,
                                  float end, unsigned is_last, float* __restrict__ out) {
    const unsigned own = threadIdx.x % TOGETHER;
    const Pixel pixel = pixel_of(tiles, tile_count, blocks, threadIdx.x / TOGETHER);
    if (TOGETHER == 1u && !pixel.is_inside) return;
    float* red = out + pixel.offset;
    float* green = red + pixel.stride;
    float* blue = green + pixel.stride;
    float* alpha = blue + pixel.stride;
    accumulate_result sum = { 0.0f, 0.0f, 0.0f, 0.0f };
    if (first != 0.0f && pixel.is_inside) sum = { *red, *green, *blue, *alpha };
    for (float sample = first + (float)own; sample < end; sample += (float)TOGETHER) {
        accumulate_result some = { 0.0f, 0.0f, 0.0f, 0.0f };
        if (pixel.is_inside) some = step_accumulate(pixel.x, pixel.y, sample, sample + 1.0f, 0.0f, 0.0f, 0.0f, 0.0f);
        UNROLL for (unsigned k = 0; k < TOGETHER; ++k) {
            const accumulate_result added = TOGETHER == 1u ? some : of_lane(some, threadIdx.x % 32u - own + k);
            sum = { sum.f0 + added.f0, sum.f1 + added.f1, sum.f2 + added.f2, sum.f3 + added.f3 };
        }
    }
    if (!pixel.is_inside || own != 0u) return;
    if (!is_last) {
        *red = sum.f0;
        *green = sum.f1;
        *blue = sum.f2;
        *alpha = sum.f3;
        return;
    }
    const mean_result mean = step_mean(sum.f0, sum.f1, sum.f2, sum.f3);
    // A file must not distinguish zeros by their sign.
    *red = mean.f0 + 0.0f;
    *green = mean.f1 + 0.0f;
    *blue = mean.f2 + 0.0f;
    *alpha = mean.f3 + 0.0f;
}

#ifdef AOV_PLANES
// Writes the layers' planes, after the color's.
extern "C" __global__ void layers(const Tile* __restrict__ tiles, unsigned tile_count, Blocks blocks,
                                  float* __restrict__ out) {
    const Pixel pixel = pixel_of(tiles, tile_count, blocks, threadIdx.x);
    if (!pixel.is_inside) return;
    const layers_result seen = step_layers(pixel.x, pixel.y);
    write_layers(seen, out + pixel.offset + 4 * pixel.stride, pixel.stride);
}
#endif
