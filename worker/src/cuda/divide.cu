// Divides the cells that a render asked for: scene/trace/src/cells/tree.rs and prune.rs, with the same operations on numbers
// in the same order, so that every device has the same cells and lists. A thread finds the list of one cell of a block.
// Where the lists are in the table depends on the order of threads, and changes no picture. No formula of a scene is
// here, so this program is compiled once for all scenes whose lists are about as deep.

// Operations that a thread reads together: a divisor of 32.
#define READ_TOGETHER 8u

INLINE_FN float largest_3(float x, float y, float z) { return max_f(max_f(x, y), z); }

// Bounds of the distances of a leaf with a Lipschitz factor.
INLINE_FN Interval lipschitz_interval(float factor, const Region& r, float at_center) {
    const float x = r.high_x - r.low_x, y = r.high_y - r.low_y, z = r.high_z - r.low_z;
    const float half_diagonal = 0.5f * sqrt_rn(fma_rn(x, x, fma_rn(y, y, z * z)));
    const float size = max_f(largest_3(abs_f(r.low_x), abs_f(r.low_y), abs_f(r.low_z)),
                             largest_3(abs_f(r.high_x), abs_f(r.high_y), abs_f(r.high_z)));
    const float change = factor * half_diagonal + ROUNDING * (size + abs_f(at_center));
    return { at_center - change, at_center + change };
}

INLINE_FN float finite_or_0(float x) { return abs_f(x) < INFINITE ? x : 0.0f; }

// Bounds of the distances of a leaf with boxes.
INLINE_FN Interval box_interval(const float* boxes, const Region& r) {
    for (unsigned level = 0; level < BOX_LEVELS; ++level) {
        const float* box = boxes + BOX_NUMBERS * level;
        float far = 0.0f, size = -INFINITE;
        const float origin[] = { r.low_x, r.low_y, r.low_z };
        for (unsigned axis = 0; axis < 3u; ++axis) {
            const float low = box[1u + axis], high = box[4u + axis];
            far = max_f(far, max_f(abs_f(finite_or_0(low)), max_f(abs_f(finite_or_0(high)), abs_f(finite_or_0(origin[axis])))));
            size = max_f(size, abs_f(finite_or_0(high - low)));
        }
        const float margin = 1e-3f * size + 1e-5f * far;
        const float high[] = { r.high_x, r.high_y, r.high_z };
        float gap = -INFINITE;
        for (unsigned axis = 0; axis < 3u; ++axis)
            gap = max_f(gap, max_f((box[1u + axis] - margin) - high[axis], origin[axis] - (box[4u + axis] + margin)));
        if (gap > 0.0f) return { box[0], INFINITE };
    }
    return { -INFINITE, INFINITE };
}

// One end of a smooth minimum; `sign` is that of the rounding errors.
INLINE_FN float smooth_end(float a, float b, float width, float sign) {
    const float overlap = max_f(width - abs_f(a - b), 0.0f);
    const float slack = 8.0f * EPSILON * (abs_f(a) + abs_f(b) + width);
    return min_f(a, b) - overlap * overlap * (0.25f / width) + sign * slack;
}

INLINE_FN Interval join_intervals(float width, Interval a, Interval b) {
    if (b.low - a.high >= width) return a;
    if (a.low - b.high >= width && a.low > b.high) return b;
    if (width > 0.0f) return { smooth_end(a.low, b.low, width, -1.0f), smooth_end(a.high, b.high, width, 1.0f) };
    return { min_f(a.low, b.low), min_f(a.high, b.high) };
}

INLINE_FN Interval scale_interval(float by, Interval value) {
    const float first = value.low * by, last = value.high * by;
    return { min_f(first, last), max_f(first, last) };
}

INLINE_FN float beyond(float value, float width) {
    return value + width + (32.0f * EPSILON * (abs_f(value) + width) + MIN_POSITIVE);
}

INLINE_FN float cutoff_of(float of_join, Interval value, Interval other, float width) {
    if (other.low >= beyond(value.high, width)) return of_join;
    const float apart = beyond(of_join, width);
    return min_f(other.low >= apart ? beyond(of_join, 0.0f) : apart, beyond(other.high, width));
}

INLINE_FN float unscaled(float cutoff, float by) {
    const float least = cutoff / by;
    return by > 0.0f ? least + 4.0f * EPSILON * abs_f(least) + MIN_POSITIVE : INFINITE;
}

// Some operations of a list, with the numbers of their joins. They are read together, because a thread that reads one
// after another waits for memory most of the time.
struct Operations {
    unsigned leaf[READ_TOGETHER], join[READ_TOGETHER];
    float number[READ_TOGETHER];
};

INLINE_FN Operations operations_at(const Division& d, const unsigned* list, unsigned first, unsigned operations) {
    Operations some;
    UNROLL for (unsigned k = 0; k < READ_TOGETHER; ++k) {
        const unsigned operation = first + k < operations ? first + k : operations - 1u;
        some.leaf[k] = list[2u * operation];
        some.join[k] = list[2u * operation + 1u];
    }
    unsigned index[READ_TOGETHER];
    UNROLL for (unsigned k = 0; k < READ_TOGETHER; ++k) index[k] = some.join[k] ? index_of_row(d, some.join[k]) : 0u;
    UNROLL for (unsigned k = 0; k < READ_TOGETHER; ++k) some.number[k] = d.joins[index[k]];
    return some;
}

// Bounds of the value of a list in a cell. Keeps the operands of joins.
INLINE_FN Interval list_interval(const Division& d, const unsigned* list, unsigned operations, const Region& region,
                                 const Scratch& scratch) {
    Interval waiting[LIST_DEPTH];
    unsigned count = 0;
    for (unsigned first = 0; first < operations; first += READ_TOGETHER) {
        const Operations some = operations_at(d, list, first, operations);
        unsigned index[READ_TOGETHER];
        float factor[READ_TOGETHER], distance[READ_TOGETHER];
        UNROLL for (unsigned k = 0; k < READ_TOGETHER; ++k)
            index[k] = function_of(some.leaf[k]) != NO_LEAF ? index_of_row(d, some.leaf[k]) : 0u;
        UNROLL for (unsigned k = 0; k < READ_TOGETHER; ++k) {
            factor[k] = d.factors[index[k]];
            distance[k] = 0.0f;
            if (first + k < operations && function_of(some.leaf[k]) != NO_LEAF) distance[k] = scratch.distance(first + k);
        }
        for (unsigned k = 0; k < READ_TOGETHER && first + k < operations; ++k) {
            if (function_of(some.leaf[k]) != NO_LEAF)
                waiting[count++] = factor[k] < INFINITE
                                       ? lipschitz_interval(factor[k], region, distance[k])
                                       : box_interval(d.boxes + BOX_NUMBERS * d.first_boxes[index[k]], region);
            if (some.join[k] == 0u) continue;
            Interval& last = waiting[count - 1u];
            if (some.join[k] & IS_UNARY) {
                last = scale_interval(some.number[k], last);
                continue;
            }
            const Interval b = last, a = waiting[count - 2u];
            scratch.operand(first + k, 0u) = a.low;
            scratch.operand(first + k, 1u) = a.high;
            scratch.operand(first + k, 2u) = b.low;
            scratch.operand(first + k, 3u) = b.high;
            --count;
            waiting[count - 1u] = join_intervals(some.number[k], a, b);
        }
    }
    return waiting[0];
}

// Finds the leaves whose values do not reach their cutoffs, from the last operation on.
INLINE_FN void cut_off(const Division& d, const unsigned* list, unsigned operations, const Scratch& scratch) {
    float waiting[LIST_DEPTH];
    unsigned count = 0;
    // Whether the values that wait can matter, the last one in the lowest bit.
    unsigned long long can_matter = 0;
    float cutoff = INFINITE;
    bool matters = true;
    unsigned bits = 0;
    for (unsigned first = (operations - 1u) / READ_TOGETHER * READ_TOGETHER;; first -= READ_TOGETHER) {
        const Operations some = operations_at(d, list, first, operations);
        float operand[READ_TOGETHER][4];
        UNROLL for (unsigned k = 0; k < READ_TOGETHER; ++k) {
            const bool has_operands = first + k < operations && some.join[k] != 0u && !(some.join[k] & IS_UNARY);
            UNROLL for (unsigned part = 0; part < 4u; ++part)
                operand[k][part] = has_operands ? scratch.operand(first + k, part) : 0.0f;
        }
        for (unsigned k = operations - first < READ_TOGETHER ? operations - first : READ_TOGETHER; k-- > 0u;) {
            const unsigned operation = first + k;
            if (some.join[k] & IS_UNARY) {
                cutoff = unscaled(cutoff, some.number[k]);
            } else if (some.join[k] != 0u) {
                const float width = some.number[k];
                const Interval a = { operand[k][0], operand[k][1] }, b = { operand[k][2], operand[k][3] };
                const float of_a = cutoff_of(cutoff, a, b, width), of_b = cutoff_of(cutoff, b, a, width);
                waiting[count++] = of_a;
                can_matter = can_matter << 1 | (unsigned long long)(matters && !(a.low >= of_a));
                cutoff = of_b;
                matters = matters && !(b.low >= of_b);
            }
            if (function_of(some.leaf[k]) != NO_LEAF) {
                bits |= (unsigned)matters << operation % 32u;
                if (count > 0u) cutoff = waiting[--count];
                matters = can_matter & 1u;
                can_matter >>= 1;
            }
            if (operation % 32u == 0u) {
                scratch.matters(operation) = bits;
                bits = 0;
            }
        }
        if (first == 0u) break;
    }
}

// Writes operations one after another, or only counts them.
struct Writer {
    unsigned* out;
    unsigned operations, leaves, leaf, join;
};

INLINE_FN void write_operation(Writer& w, unsigned leaf, unsigned join, unsigned is_last) {
    if (w.operations > 0u && w.out) {
        w.out[2u * w.operations - 2u] = w.leaf | is_last;
        w.out[2u * w.operations - 1u] = w.join;
    }
    if (is_last) return;
    ++w.operations;
    w.leaf = leaf;
    w.join = join;
}

// The operations of a list that can matter; where `out` is null, their number.
INLINE_FN Writer write_list(const unsigned* list, unsigned operations, const Scratch& scratch, unsigned* out) {
    Writer w = { out, 0u, 0u, 0u, 0u };
    // Whether the values that wait can matter, the last one in the lowest bit.
    unsigned long long can_matter = 0;
    unsigned bits = 0;
    for (unsigned first = 0; first < operations; first += READ_TOGETHER) {
        unsigned leaves[READ_TOGETHER], joins[READ_TOGETHER];
        UNROLL for (unsigned k = 0; k < READ_TOGETHER; ++k) {
            const unsigned operation = first + k < operations ? first + k : first;
            leaves[k] = list[2u * operation] & ~IS_LAST;
            joins[k] = list[2u * operation + 1u];
        }
        if (first % 32u == 0u) bits = scratch.matters(first);
        for (unsigned k = 0; k < READ_TOGETHER && first + k < operations; ++k) {
            const unsigned leaf = leaves[k], join = joins[k];
            if (function_of(leaf) != NO_LEAF) {
                const unsigned matters = bits >> (first + k) % 32u & 1u;
                can_matter = can_matter << 1 | matters;
                if (matters) {
                    write_operation(w, leaf, 0u, 0u);
                    ++w.leaves;
                }
            }
            if (join == 0u) continue;
            unsigned is_kept = can_matter & 1u;
            if (!(join & IS_UNARY)) {
                const unsigned long long a = can_matter >> 1 & 1u;
                can_matter = can_matter >> 1 | is_kept;
                is_kept &= (unsigned)a;
            }
            if (!is_kept) continue;
            // A leaf that nothing has joined yet is the second value alone.
            if (w.join == 0u && !(join & IS_UNARY)) w.join = join;
            else write_operation(w, NO_LEAF << ROW_BITS, join, 0u);
        }
    }
    write_operation(w, 0u, 0u, IS_LAST);
    return w;
}

// Word of a cell of a block; 0 if there is no room.
INLINE_FN unsigned word_of_cell(const Division& d, unsigned thread) {
    const unsigned* record = d.words + d.missing[thread / BLOCK_CELLS];
    const unsigned child = thread % BLOCK_CELLS, level = record[LEVEL] + 1u, operations = record[LENGTH] / 2u;
    const unsigned* list = d.words + record[LIST];
    const CellOfBlock cell = cell_of_block(d, record, child);
    const Scratch scratch = scratch_of(d, thread);
    const Interval value = list_interval(d, list, operations, region_of(d, cell, level), scratch);
    if (value.low > MIN_POSITIVE) return bits_of(value.low) >> 1;
    cut_off(d, list, operations, scratch);
    const Writer kept = write_list(list, operations, scratch, 0);
    unsigned leaves = 0;
    for (unsigned operation = 0; operation < operations; ++operation)
        leaves += function_of(list[2u * operation]) != NO_LEAF;
    const bool has_surface = value.high >= 0.0f, is_whole = kept.operations == operations;
    const bool is_shorter = level <= d.rules.coarse_levels || (float)kept.leaves <= d.rules.shorter * (float)leaves;
    const unsigned stalls = is_shorter ? 0u : record[STALLS] + 1u;
    const bool is_divided =
        has_surface && kept.leaves > d.rules.short_list && stalls < d.rules.max_stalls && level < d.rules.levels;
    const unsigned words = (is_whole ? 0u : 2u * kept.operations) + (is_divided ? RECORD_WORDS : 0u);
    unsigned at = fetch_add(d.state, words);
    if (at > d.capacity || d.capacity - at < words) {
        d.state[1] = 1u;
        return 0u;
    }
    unsigned index = record[LIST];
    if (!is_whole) {
        write_list(list, operations, scratch, d.words + at);
        index = at;
        at += 2u * kept.operations;
    }
    if (!is_divided) return 1u << KIND_SHIFT | index;
    unsigned* own = d.words + at;
    own[PLACE] = d.first_block + thread / BLOCK_CELLS * (BLOCK_CELLS + 1u) + child;
    own[AT_X] = cell.x;
    own[AT_Y] = cell.y;
    own[AT_Z] = cell.z;
    own[LEVEL] = level;
    own[LIST] = index;
    own[LENGTH] = 2u * kept.operations;
    own[STALLS] = stalls;
    return 3u << KIND_SHIFT | at;
}

// Fills the blocks of the missing cells.
extern "C" __global__ void divide(Division d) {
    const unsigned thread = blockIdx.x * blockDim.x + threadIdx.x, cell = thread / BLOCK_CELLS;
    if (cell >= d.cells) return;
    const unsigned block = d.first_block + cell * (BLOCK_CELLS + 1u);
    const unsigned word = word_of_cell(d, thread);
    d.words[block + thread % BLOCK_CELLS] = word;
    if (thread % BLOCK_CELLS == 0u) d.words[block + BLOCK_CELLS] = d.words[d.missing[cell] + LIST];
}

// Gives the blocks to their cells, once all have their words.
extern "C" __global__ void publish(Division d) {
    const unsigned cell = blockIdx.x * blockDim.x + threadIdx.x;
    if (cell >= d.cells || d.state[1] != 0u) return;
    d.words[d.words[d.missing[cell] + PLACE]] = 2u << KIND_SHIFT | (d.first_block + cell * (BLOCK_CELLS + 1u));
}
