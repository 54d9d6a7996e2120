// Distances of the leaves of the missing cells' lists at the centers of the cells of their blocks.
extern "C" __global__ void measure(Division d) {
    const size_t turn = (size_t)blockIdx.x * blockDim.x + threadIdx.x, threads = (size_t)d.cells * BLOCK_CELLS;
    const unsigned operation = (unsigned)(turn / threads), thread = (unsigned)(turn % threads);
    const unsigned* record = d.words + d.missing[thread / BLOCK_CELLS];
    if (operation >= d.longest || operation >= record[LENGTH] / 2u) return;
    const unsigned leaf = d.words[record[LIST] + 2u * operation];
    if (function_of(leaf) == NO_LEAF) return;
    const CellOfBlock cell = cell_of_block(d, record, thread % BLOCK_CELLS);
    const Region r = region_of(d, cell, record[LEVEL] + 1u);
    const float list = float_from_bits(d.rules.leaf_lists + 2u * index_of_row(d, leaf));
    const fold_result value = step_fold(list, (r.low_x + r.high_x) * 0.5f, (r.low_y + r.high_y) * 0.5f,
                                        (r.low_z + r.high_z) * 0.5f);
    scratch_of(d, thread).distance(operation) = value.f0;
}
