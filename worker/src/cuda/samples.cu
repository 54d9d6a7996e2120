
// ---- samples, one after another ----

INLINE_FN Sum of_lane(const Sum& x, unsigned lane) {
    Sum sum = { from_lane(x.red, lane), from_lane(x.green, lane), from_lane(x.blue, lane), from_lane(x.alpha, lane) };
#ifdef PART_PLANES
    UNROLL for (unsigned plane = 0; plane < PART_PLANES; ++plane) sum.parts[plane] = from_lane(x.parts[plane], lane);
#endif
    return sum;
}

// Adds the samples from `first` until before `end`, which are in one batch, to the sums in `out`.
//
// Neighboring threads render TOGETHER samples of a pixel, because these take similar branches: a power of two up to 32
// that divides the number of samples. Each of them adds all samples in their order.
extern "C" __global__ void render(const Tile* __restrict__ tiles, unsigned tile_count, Blocks blocks, float first,
                                  float end, unsigned is_last, float* __restrict__ out) {
    const unsigned own = threadIdx.x % TOGETHER;
    const Pixel pixel = pixel_of(tiles, tile_count, blocks, threadIdx.x / TOGETHER);
    if (TOGETHER == 1u && !pixel.is_inside) return;
    Sum sum = pixel.is_inside ? sum_before(first, pixel, out) : Sum{ 0.0f, 0.0f, 0.0f, 0.0f };
    for (float sample = first + (float)own; sample < end; sample += (float)TOGETHER) {
        const Sum none = { 0.0f, 0.0f, 0.0f, 0.0f };
        Sum some = none;
        if (pixel.is_inside) {
            const accumulate_result one =
                step_accumulate(pixel.x, pixel.y, sample, sample + 1.0f, 0.0f, 0.0f, 0.0f, 0.0f PARTS_OF(none));
            some = { one.f0, one.f1, one.f2, one.f3 PARTS_FROM(one, ) };
        }
        UNROLL for (unsigned k = 0; k < TOGETHER; ++k) {
            sum = sum + (TOGETHER == 1u ? some : of_lane(some, threadIdx.x % 32u - own + k));
        }
    }
    if (pixel.is_inside && own == 0u) write_sum(sum, first, end, is_last, pixel, out);
}
