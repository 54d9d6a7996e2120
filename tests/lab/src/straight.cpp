// Straight C++ of a scene's distance: what a programmer would write by hand for this scene and these vector
// instructions. `sdfarm-lab straight` compiles it and compares it with the machine code of recorded formulas.
//
// Reads the points; writes the number of packets that it evaluates at once, and the distances; then evaluates the
// points for each number of seconds that it reads, and writes the points per second.

#include <immintrin.h>

#include <chrono>
#include <cstdio>

#define INLINE_FN static inline __attribute__((always_inline))
#define NOINLINE_FN INLINE_FN
#define FLOAT(bits) __builtin_bit_cast(float, bits)

// One packet of lanes. Every operation has the definition of `scene::real::Real`.
#ifdef __AVX512F__
constexpr int LANES = 16;
typedef __m512 Numbers;
typedef __m512i Words;
typedef __mmask16 Masks;
#define VECTOR(name) _mm512_##name
#define BITS(name) _mm512_##name##_si512
#define AS_NUMBERS _mm512_castsi512_ps
INLINE_FN Masks less(Numbers a, Numbers b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
INLINE_FN Numbers select(Masks mask, Numbers yes, Numbers no) { return _mm512_mask_blend_ps(mask, no, yes); }
INLINE_FN Masks both(Masks a, Masks b) { return a & b; }
INLINE_FN Masks either(Masks a, Masks b) { return a | b; }
INLINE_FN Masks opposite(Masks a) { return ~a; }
INLINE_FN Masks all_or_none(bool all) { return all ? 0xffff : 0; }
INLINE_FN Numbers floors(Numbers x) { return _mm512_roundscale_ps(x, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC); }
INLINE_FN Numbers roots(Numbers x) {
    return _mm512_maskz_sqrt_ps(_mm512_cmp_ps_mask(x, _mm512_set1_ps(1e-28f), _CMP_NLT_UQ), x);
}
#else
constexpr int LANES = 8;
typedef __m256 Numbers;
typedef __m256i Words;
struct Masks { __m256 lanes; };
#define VECTOR(name) _mm256_##name
#define BITS(name) _mm256_##name##_si256
#define AS_NUMBERS _mm256_castsi256_ps
INLINE_FN Masks less(Numbers a, Numbers b) { return {_mm256_cmp_ps(a, b, _CMP_LT_OQ)}; }
INLINE_FN Numbers select(Masks mask, Numbers yes, Numbers no) { return _mm256_blendv_ps(no, yes, mask.lanes); }
INLINE_FN Masks both(Masks a, Masks b) { return {_mm256_and_ps(a.lanes, b.lanes)}; }
INLINE_FN Masks either(Masks a, Masks b) { return {_mm256_or_ps(a.lanes, b.lanes)}; }
INLINE_FN Masks all_or_none(bool all) { return {_mm256_castsi256_ps(_mm256_set1_epi32(all ? -1 : 0))}; }
INLINE_FN Masks opposite(Masks a) { return {_mm256_xor_ps(a.lanes, all_or_none(true).lanes)}; }
INLINE_FN Numbers floors(Numbers x) { return _mm256_floor_ps(x); }
INLINE_FN Numbers roots(Numbers x) {
    return _mm256_and_ps(_mm256_cmp_ps(x, _mm256_set1_ps(1e-28f), _CMP_NLT_UQ), _mm256_sqrt_ps(x));
}
#endif

// ---- packets ----
// Several packets at once: their operations alternate, so that none waits for its predecessor's result.
struct Number {
    Numbers packet[PACKETS];
    Number() = default;
    Number(float x) { for (Numbers& all : packet) all = VECTOR(set1_ps)(x); }
};
struct Word {
    Words packet[PACKETS];
    Word() = default;
    Word(unsigned x) { for (Words& all : packet) all = VECTOR(set1_epi32)(int(x)); }
};
struct Condition {
    Masks packet[PACKETS];
    Condition() = default;
    Condition(bool x) { for (Masks& all : packet) all = all_or_none(x); }
};

#define DEFINE(Result, name, Parameters, expression) \
    INLINE_FN Result name Parameters { \
        Result result; \
        for (int i = 0; i < PACKETS; ++i) result.packet[i] = expression; \
        return result; \
    }
#define A a.packet[i]
#define B b.packet[i]
#define C c.packet[i]
DEFINE(Number, operator+, (Number a, Number b), VECTOR(add_ps)(A, B))
DEFINE(Number, operator-, (Number a, Number b), VECTOR(sub_ps)(A, B))
DEFINE(Number, operator*, (Number a, Number b), VECTOR(mul_ps)(A, B))
DEFINE(Number, operator-, (Number a), VECTOR(xor_ps)(A, VECTOR(set1_ps)(-0.0f)))
DEFINE(Number, div_rn, (Number a, Number b), VECTOR(div_ps)(A, B))
DEFINE(Number, fma_rn, (Number a, Number b, Number c), VECTOR(fmadd_ps)(A, B, C))
DEFINE(Number, min_f, (Number a, Number b), VECTOR(min_ps)(B, A))
DEFINE(Number, max_f, (Number a, Number b), VECTOR(max_ps)(B, A))
DEFINE(Number, abs_f, (Number a), VECTOR(andnot_ps)(VECTOR(set1_ps)(-0.0f), A))
DEFINE(Number, floor_f, (Number a), floors(A))
DEFINE(Number, sqrt_rn, (Number a), roots(A))
DEFINE(Number, select_f, (Condition c, Number a, Number b), select(C, A, B))
DEFINE(Condition, operator<, (Number a, Number b), less(A, B))
DEFINE(Condition, operator&&, (Condition a, Condition b), both(A, B))
DEFINE(Condition, operator||, (Condition a, Condition b), either(A, B))
DEFINE(Condition, operator!, (Condition a), opposite(A))
DEFINE(Word, bits_of, (Number a), BITS(castps)(A))
DEFINE(Number, float_from_bits, (Word a), AS_NUMBERS(A))
DEFINE(Word, operator+, (Word a, Word b), VECTOR(add_epi32)(A, B))
DEFINE(Word, operator*, (Word a, Word b), VECTOR(mullo_epi32)(A, B))
DEFINE(Word, operator^, (Word a, Word b), BITS(xor)(A, B))
DEFINE(Word, operator&, (Word a, Word b), BITS(and)(A, B))
DEFINE(Word, operator|, (Word a, Word b), BITS(or)(A, B))
DEFINE(Word, operator<<, (Word a, Word b), VECTOR(sllv_epi32)(A, B))
DEFINE(Word, operator>>, (Word a, Word b), VECTOR(srlv_epi32)(A, B))
#undef A
#undef B
#undef C
#undef DEFINE

#define float Number
#define bool Condition
#define unsigned Word
// ---- the distance ----
#undef float
#undef bool
#undef unsigned

// Writes the distances of the points.
static __attribute__((noinline)) void evaluate(const float* points, float* distances) {
    for (int first = 0; first < POINTS; first += PACKETS * LANES) {
        Number x, y, z;
        for (int i = 0; i < PACKETS; ++i) {
            const float* from = points + first + i * LANES;
            x.packet[i] = VECTOR(load_ps)(from);
            y.packet[i] = VECTOR(load_ps)(from + POINTS);
            z.packet[i] = VECTOR(load_ps)(from + 2 * POINTS);
        }
        const Number found = step_distance_at_point(x, y, z).f0;
        for (int i = 0; i < PACKETS; ++i) VECTOR(store_ps)(distances + first + i * LANES, found.packet[i]);
    }
}
// ---- the program ----
typedef void Evaluate(const float*, float*);

// Evaluates the points for about this time; returns the points per second.
static double points_per_second(double seconds, Evaluate* evaluate, const float* points, float* distances) {
    constexpr int CALLS = 64;
    typedef std::chrono::steady_clock Clock;
    const Clock::time_point start = Clock::now();
    for (double done = 0;;) {
        for (int call = 0; call < CALLS; ++call) evaluate(points, distances);
        done += double(CALLS) * POINTS;
        const double elapsed = std::chrono::duration<double>(Clock::now() - start).count();
        if (elapsed >= seconds) return done / elapsed;
    }
}

static bool read(void* to, size_t size) { return fread(to, size, 1, stdin) == 1; }

static bool write(const void* from, size_t size) { return fwrite(from, size, 1, stdout) == 1 && fflush(stdout) == 0; }

int main() {
    alignas(64) static float points[3 * POINTS], distances[POINTS];
    if (!read(points, sizeof points)) return 1;
    Evaluate* const all[] = {packets_1::evaluate, packets_2::evaluate, packets_4::evaluate};
    const unsigned counts[] = {1, 2, 4};
    int fastest = 0;
    double best = 0;
    for (int trial = 0; trial < 9; ++trial) {
        const double rate = points_per_second(0.02, all[trial % 3], points, distances);
        if (rate > best) best = rate, fastest = trial % 3;
    }
    all[fastest](points, distances);
    if (!write(&counts[fastest], 4) || !write(distances, sizeof distances)) return 1;
    for (double seconds; read(&seconds, sizeof seconds);) {
        const double rate = points_per_second(seconds, all[fastest], points, distances);
        if (!write(&rate, sizeof rate)) return 1;
    }
    return 0;
}
