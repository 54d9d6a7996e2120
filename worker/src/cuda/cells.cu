// The cells that a render asked for, and the memory with which they are divided: for measure.cu, which is compiled with
// each scene, and divide.cu, which is a program of its own.

// Rules of a scene, as in division.rs.
struct Rules {
    float center_x, center_y, center_z, unit, shorter;
    unsigned levels, coarse_levels, leaf_lists, short_list, max_stalls;
};

// The scene's numbers, as in division.rs, and where to write.
struct Division {
    unsigned* words;
    // Number of words that are used, and whether there was no room for some.
    unsigned* state;
    const unsigned* missing;
    const float *factors, *boxes, *joins;
    const unsigned* first_boxes;
    float* scratch;
    // Cells to divide, and the index of the first one's block.
    unsigned cells, first_block;
    // Operations of the longest list.
    unsigned longest;
    unsigned capacity;
    Rules rules;
};

// Words of a cell that is to be divided, from its index on.
enum Record { PLACE, AT_X, AT_Y, AT_Z, LEVEL, LIST, LENGTH, STALLS, RECORD_WORDS };

struct Region { float low_x, low_y, low_z, high_x, high_y, high_z; };
struct Interval { float low, high; };
struct CellOfBlock { unsigned x, y, z; };

// The box of a cell along an axis, and of some more, because of rounding.
INLINE_FN Interval side(const Division& d, unsigned at, float center, unsigned level) {
    const float half = 0.5f * (float)(1u << 2u * d.rules.levels), size = (float)(1u << 2u * (d.rules.levels - level));
    const float first = ((float)at - half) * d.rules.unit + center;
    const float last = ((float)at - half + size) * d.rules.unit + center;
    const float margin = 4.0f * EPSILON * (max_f(abs_f(first), abs_f(last)) + abs_f(center));
    return { first - margin, last + margin };
}

INLINE_FN CellOfBlock cell_of_block(const Division& d, const unsigned* record, unsigned child) {
    const unsigned size = 1u << 2u * (d.rules.levels - record[LEVEL] - 1u);
    return { record[AT_X] + child % 4u * size, record[AT_Y] + child / 4u % 4u * size, record[AT_Z] + child / 16u * size };
}

INLINE_FN Region region_of(const Division& d, const CellOfBlock& cell, unsigned level) {
    const Interval x = side(d, cell.x, d.rules.center_x, level), y = side(d, cell.y, d.rules.center_y, level),
                   z = side(d, cell.z, d.rules.center_z, level);
    return { x.low, y.low, z.low, x.high, y.high, z.high };
}

// The scratch memory of a thread: for each operation the distance of its leaf, then both operands of its join, then a
// bit that tells whether its leaf can matter.
struct Scratch {
    float* first;
    size_t stride, longest;
    INLINE_METHOD float& distance(unsigned operation) const { return first[operation * stride]; }
    INLINE_METHOD float& operand(unsigned operation, unsigned part) const {
        return first[(longest + 4 * (size_t)operation + part) * stride];
    }
    INLINE_METHOD unsigned& matters(unsigned operation) const {
        return *(unsigned*)(first + (5 * longest + operation / 32u) * stride);
    }
};

INLINE_FN Scratch scratch_of(const Division& d, unsigned thread) {
    return { d.scratch + thread, (size_t)d.cells * BLOCK_CELLS, d.longest };
}

INLINE_FN unsigned function_of(unsigned word) { return word >> ROW_BITS & NO_LEAF; }
INLINE_FN unsigned index_of_row(const Division& d, unsigned word) { return d.words[(word & ROW_MASK) - 1u]; }

