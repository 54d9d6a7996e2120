
// ---- paths of light ----

// Words of a lane: whether its march goes on, its sample, and its sum.
#define GOES_ON 0u
#define SAMPLE MARCH_WORDS
#define SUM (SAMPLE + 1u)

// Adds the samples from `first` until before `end`, which are in one batch, to the sums in `out`.
//
// The threads of a warp march together, until less than one of PAUSE of those that began still march. Then the others take
// the step after their march, and all march on.
extern "C" __global__ void render(const Tile* __restrict__ tiles, unsigned tile_count, Blocks blocks, float first,
                                  float end, unsigned is_last, float* __restrict__ out) {
    const unsigned warp = threads_together();
    const Pixel pixel = pixel_of(tiles, tile_count, blocks, threadIdx.x);
    float lane[LANE_WORDS];
    if (pixel.is_inside) lane_start_into(pixel.x, pixel.y, first, sum_before(first, pixel, out), lane);
    bool is_rendering = pixel.is_inside;
    while (count_of(warp, is_rendering) != 0u) {
        bool marches = is_rendering && lane[GOES_ON] != 0.0f;
        float ray[RAY_WORDS];
        if (marches) ray_of_lane_into(lane, ray);
        const unsigned began = count_of(warp, marches);
        for (unsigned left = began; left != 0u && PAUSE * left >= began; left = count_of(warp, marches)) {
            if (marches) {
                march_step_into(ray, lane);
                marches = lane[GOES_ON] != 0.0f;
            }
        }
        if (is_rendering && !marches) {
            after_march_into(pixel.x, pixel.y, lane);
            is_rendering = lane[SAMPLE] < end;
        }
    }
    if (!pixel.is_inside) return;
    Sum sum = { lane[SUM], lane[SUM + 1u], lane[SUM + 2u], lane[SUM + 3u] };
#ifdef PART_PLANES
    UNROLL for (unsigned plane = 0; plane < PART_PLANES; ++plane) sum.parts[plane] = lane[SUM + 4u + plane];
#endif
    write_sum(sum, first, end, is_last, pixel, out);
}
