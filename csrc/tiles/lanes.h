// The type Lanes: 16 floats, one per pixel of a 4 x 4 block. The vector type of Lanes depends on the instruction set
// that this file is compiled for. A dispatched file (common/dispatch.h) includes this file inside its namespace.
// Additions have the same order for all instruction sets, so all results except those of multiply_add have the same
// bits.
//
// multiply_add(a, b, c) returns a * b + c. Instruction sets with fused multiply-add do not round the product a * b; all
// others round it. For positive normal numbers a = m * 2^e with m in [1, 2), exponent_of(a) returns e and
// mantissa_of(a) returns m. times_power_of_two(a, power) returns a * 2^power, where `power` must be a whole number and
// a * 2^power must be a normal number. minimum(a, b) and maximum(a, b) return b where a or b is NaN.

#if defined(__AVX512F__) && defined(__AVX512DQ__) && defined(__AVX512VL__)

struct Mask {
    __mmask16 bits;
};
struct Lanes {
    __m512 value;
};

inline Lanes broadcast(float x) { return {_mm512_set1_ps(x)}; }
inline Lanes load(const float* p) { return {_mm512_loadu_ps(p)}; }
inline void store(float* p, Lanes a) { _mm512_storeu_ps(p, a.value); }
inline Lanes operator+(Lanes a, Lanes b) { return {_mm512_add_ps(a.value, b.value)}; }
inline Lanes operator-(Lanes a, Lanes b) { return {_mm512_sub_ps(a.value, b.value)}; }
inline Lanes operator*(Lanes a, Lanes b) { return {_mm512_mul_ps(a.value, b.value)}; }
inline Lanes operator/(Lanes a, Lanes b) { return {_mm512_div_ps(a.value, b.value)}; }
inline Mask operator>(Lanes a, Lanes b) { return {_mm512_cmp_ps_mask(a.value, b.value, _CMP_GT_OQ)}; }
inline Mask operator>=(Lanes a, Lanes b) { return {_mm512_cmp_ps_mask(a.value, b.value, _CMP_GE_OQ)}; }
inline Mask operator&(Mask a, Mask b) { return {static_cast<__mmask16>(a.bits & b.bits)}; }
inline bool any(Mask a) { return a.bits != 0; }
inline unsigned bits_of(Mask a) { return a.bits; }
inline Lanes minimum(Lanes a, Lanes b) { return {_mm512_min_ps(a.value, b.value)}; }
inline Lanes maximum(Lanes a, Lanes b) { return {_mm512_max_ps(a.value, b.value)}; }
inline Lanes square_root(Lanes a) { return {_mm512_sqrt_ps(a.value)}; }
inline Lanes multiply_add(Lanes a, Lanes b, Lanes c) { return {_mm512_fmadd_ps(a.value, b.value, c.value)}; }
inline Lanes exponent_of(Lanes a) {
    const __m512i bits = _mm512_srli_epi32(_mm512_castps_si512(a.value), 23);
    return {_mm512_cvtepi32_ps(_mm512_sub_epi32(bits, _mm512_set1_epi32(127)))};
}
inline Lanes mantissa_of(Lanes a) {
    const __m512i bits = _mm512_and_si512(_mm512_castps_si512(a.value), _mm512_set1_epi32(0x007fffff));
    return {_mm512_castsi512_ps(_mm512_or_si512(bits, _mm512_set1_epi32(0x3f800000)))};
}
inline Lanes times_power_of_two(Lanes a, Lanes power) {
    const __m512i shift = _mm512_slli_epi32(_mm512_cvttps_epi32(power.value), 23);
    return {_mm512_castsi512_ps(_mm512_add_epi32(_mm512_castps_si512(a.value), shift))};
}
inline Lanes select(Mask m, Lanes a, Lanes b) { return {_mm512_mask_blend_ps(m.bits, b.value, a.value)}; }
inline Lanes keep(Mask m, Lanes a) { return {_mm512_maskz_mov_ps(m.bits, a.value)}; }
// Packs four Lanes into one 32-bit word per pixel. Values from 0 to 255.99 are truncated to bytes. The first of the
// four Lanes becomes the lowest byte of each word.
inline void store_packed(std::uint32_t* to, const Lanes* bytes) {
    __m512i packed = _mm512_cvttps_epi32(bytes[0].value);
    packed = _mm512_or_si512(packed, _mm512_slli_epi32(_mm512_cvttps_epi32(bytes[1].value), 8));
    packed = _mm512_or_si512(packed, _mm512_slli_epi32(_mm512_cvttps_epi32(bytes[2].value), 16));
    packed = _mm512_or_si512(packed, _mm512_slli_epi32(_mm512_cvttps_epi32(bytes[3].value), 24));
    _mm512_storeu_si512(to, packed);
}
// Adds lane i + 8 to lane i, then lane i + 4 to lane i, and returns lanes 0 to 3.
#define FOURD_SUM_OF_QUARTERS
inline __m128 sum_of_quarters(Lanes a) {
    const __m256 half = _mm256_add_ps(_mm512_castps512_ps256(a.value), _mm512_extractf32x8_ps(a.value, 1));
    return _mm_add_ps(_mm256_castps256_ps128(half), _mm256_extractf128_ps(half, 1));
}

#elif defined(__GNUC__)

#if defined(__AVX__)
constexpr int kNative = 8;
#else
constexpr int kNative = 4;
#endif
constexpr int kParts = 16 / kNative;
typedef float NativeFloat __attribute__((vector_size(4 * kNative)));
typedef std::int32_t NativeInt __attribute__((vector_size(4 * kNative)));

struct Mask {
    NativeInt part[kParts];
};
struct Lanes {
    NativeFloat part[kParts];
};

#define FOURD_PER_PART(expression)                             \
    for (int p = 0; p < kParts; ++p) out.part[p] = expression; \
    return out

inline Lanes broadcast(float x) {
    Lanes out;
    FOURD_PER_PART(x - NativeFloat{});
}
inline Lanes load(const float* p) {
    Lanes out;
    std::memcpy(&out, p, sizeof out);
    return out;
}
inline void store(float* p, Lanes a) { std::memcpy(p, &a, sizeof a); }
inline Lanes operator+(Lanes a, Lanes b) {
    Lanes out;
    FOURD_PER_PART(a.part[p] + b.part[p]);
}
inline Lanes operator-(Lanes a, Lanes b) {
    Lanes out;
    FOURD_PER_PART(a.part[p] - b.part[p]);
}
inline Lanes operator*(Lanes a, Lanes b) {
    Lanes out;
    FOURD_PER_PART(a.part[p] * b.part[p]);
}
inline Lanes operator/(Lanes a, Lanes b) {
    Lanes out;
    FOURD_PER_PART(a.part[p] / b.part[p]);
}
inline Mask operator>(Lanes a, Lanes b) {
    Mask out;
    FOURD_PER_PART(a.part[p] > b.part[p]);
}
inline Mask operator>=(Lanes a, Lanes b) {
    Mask out;
    FOURD_PER_PART(a.part[p] >= b.part[p]);
}
inline Mask operator&(Mask a, Mask b) {
    Mask out;
    FOURD_PER_PART(a.part[p] & b.part[p]);
}
inline Lanes minimum(Lanes a, Lanes b) {
    Lanes out;
    FOURD_PER_PART(a.part[p] < b.part[p] ? a.part[p] : b.part[p]);
}
inline Lanes maximum(Lanes a, Lanes b) {
    Lanes out;
    FOURD_PER_PART(a.part[p] > b.part[p] ? a.part[p] : b.part[p]);
}
inline Lanes square_root(Lanes a) {
    Lanes out;
#if defined(__AVX__)
    FOURD_PER_PART((NativeFloat)_mm256_sqrt_ps((__m256)a.part[p]));
#elif defined(__SSE2__)
    FOURD_PER_PART((NativeFloat)_mm_sqrt_ps((__m128)a.part[p]));
#else
    for (int p = 0; p < kParts; ++p) {
        for (int lane = 0; lane < kNative; ++lane) out.part[p][lane] = __builtin_sqrtf(a.part[p][lane]);
    }
    return out;
#endif
}
inline Lanes multiply_add(Lanes a, Lanes b, Lanes c) {
    Lanes out;
#if defined(__AVX__) && defined(__FMA__)
    FOURD_PER_PART((NativeFloat)_mm256_fmadd_ps((__m256)a.part[p], (__m256)b.part[p], (__m256)c.part[p]));
#else
    FOURD_PER_PART(a.part[p] * b.part[p] + c.part[p]);
#endif
}
inline Lanes exponent_of(Lanes a) {
    Lanes out;
    FOURD_PER_PART(__builtin_convertvector(((NativeInt)a.part[p] >> 23) - 127, NativeFloat));
}
inline Lanes mantissa_of(Lanes a) {
    Lanes out;
    FOURD_PER_PART((NativeFloat)(((NativeInt)a.part[p] & 0x007fffff) | 0x3f800000));
}
inline Lanes times_power_of_two(Lanes a, Lanes power) {
    Lanes out;
    FOURD_PER_PART((NativeFloat)((NativeInt)a.part[p] + (__builtin_convertvector(power.part[p], NativeInt) << 23)));
}
inline unsigned bits_of(Mask a) {
    unsigned bits = 0;
#if defined(__AVX__)
    for (int p = 0; p < kParts; ++p) bits |= static_cast<unsigned>(_mm256_movemask_ps((__m256)a.part[p])) << (8 * p);
#elif defined(__SSE2__)
    for (int p = 0; p < kParts; ++p) bits |= static_cast<unsigned>(_mm_movemask_ps((__m128)a.part[p])) << (4 * p);
#else
    for (int i = 0; i < 16; ++i) bits |= static_cast<unsigned>(a.part[i / kNative][i % kNative] != 0) << i;
#endif
    return bits;
}
inline Lanes select(Mask m, Lanes a, Lanes b) {
    Lanes out;
    FOURD_PER_PART(m.part[p] ? a.part[p] : b.part[p]);
}
inline Lanes keep(Mask m, Lanes a) {
    Lanes out;
    FOURD_PER_PART((NativeFloat)((NativeInt)a.part[p] & m.part[p]));
}
inline bool any(Mask a) {
    NativeInt all = a.part[0];
    for (int p = 1; p < kParts; ++p) all |= a.part[p];
#if defined(__AVX__)
    return _mm256_movemask_ps((__m256)all) != 0;
#elif defined(__SSE2__)
    return _mm_movemask_ps((__m128)all) != 0;
#else
    std::int32_t either = 0;
    for (int lane = 0; lane < kNative; ++lane) either |= all[lane];
    return either != 0;
#endif
}

inline void store_packed(std::uint32_t* to, const Lanes* bytes) {
    for (int p = 0; p < kParts; ++p) {
        NativeInt packed = __builtin_convertvector(bytes[0].part[p], NativeInt);
        for (int c = 1; c < 4; ++c) packed |= __builtin_convertvector(bytes[c].part[p], NativeInt) << (8 * c);
        std::memcpy(to + kNative * p, &packed, sizeof packed);
    }
}

#undef FOURD_PER_PART

#if defined(__SSE2__)
#define FOURD_SUM_OF_QUARTERS
#endif
#if defined(__AVX__)
inline __m128 sum_of_quarters(Lanes a) {
    const __m256 half = (__m256)(a.part[0] + a.part[1]);
    return _mm_add_ps(_mm256_castps256_ps128(half), _mm256_extractf128_ps(half, 1));
}
#elif defined(__SSE2__)
inline __m128 sum_of_quarters(Lanes a) { return (__m128)((a.part[0] + a.part[2]) + (a.part[1] + a.part[3])); }
#endif

#else

struct Mask {
    bool lane[16];
};
struct Lanes {
    float lane[16];
};

#define FOURD_PER_LANE(expression)                           \
    for (int i = 0; i < 16; ++i) out.lane[i] = (expression); \
    return out

inline Lanes broadcast(float x) {
    Lanes out;
    FOURD_PER_LANE(x);
}
inline Lanes load(const float* p) {
    Lanes out;
    FOURD_PER_LANE(p[i]);
}
inline void store(float* p, const Lanes& a) { std::memcpy(p, a.lane, sizeof a.lane); }
inline Lanes operator+(const Lanes& a, const Lanes& b) {
    Lanes out;
    FOURD_PER_LANE(a.lane[i] + b.lane[i]);
}
inline Lanes operator-(const Lanes& a, const Lanes& b) {
    Lanes out;
    FOURD_PER_LANE(a.lane[i] - b.lane[i]);
}
inline Lanes operator*(const Lanes& a, const Lanes& b) {
    Lanes out;
    FOURD_PER_LANE(a.lane[i] * b.lane[i]);
}
inline Lanes operator/(const Lanes& a, const Lanes& b) {
    Lanes out;
    FOURD_PER_LANE(a.lane[i] / b.lane[i]);
}
inline Mask operator>(const Lanes& a, const Lanes& b) {
    Mask out;
    FOURD_PER_LANE(a.lane[i] > b.lane[i]);
}
inline Mask operator>=(const Lanes& a, const Lanes& b) {
    Mask out;
    FOURD_PER_LANE(a.lane[i] >= b.lane[i]);
}
inline Mask operator&(const Mask& a, const Mask& b) {
    Mask out;
    FOURD_PER_LANE(a.lane[i] && b.lane[i]);
}
inline Lanes minimum(const Lanes& a, const Lanes& b) {
    Lanes out;
    FOURD_PER_LANE(a.lane[i] < b.lane[i] ? a.lane[i] : b.lane[i]);
}
inline Lanes maximum(const Lanes& a, const Lanes& b) {
    Lanes out;
    FOURD_PER_LANE(a.lane[i] > b.lane[i] ? a.lane[i] : b.lane[i]);
}
inline Lanes square_root(const Lanes& a) {
    Lanes out;
    FOURD_PER_LANE(sqrtf(a.lane[i]));
}
inline Lanes multiply_add(const Lanes& a, const Lanes& b, const Lanes& c) {
    Lanes out;
    FOURD_PER_LANE(a.lane[i] * b.lane[i] + c.lane[i]);
}
inline std::int32_t bits_of(float value) {
    std::int32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits;
}
inline float float_of(std::int32_t bits) {
    float value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}
inline Lanes exponent_of(const Lanes& a) {
    Lanes out;
    FOURD_PER_LANE(static_cast<float>((bits_of(a.lane[i]) >> 23) - 127));
}
inline Lanes mantissa_of(const Lanes& a) {
    Lanes out;
    FOURD_PER_LANE(float_of((bits_of(a.lane[i]) & 0x007fffff) | 0x3f800000));
}
inline Lanes times_power_of_two(const Lanes& a, const Lanes& power) {
    Lanes out;
    FOURD_PER_LANE(float_of(bits_of(a.lane[i]) + static_cast<std::int32_t>(power.lane[i]) * (1 << 23)));
}
inline unsigned bits_of(const Mask& a) {
    unsigned bits = 0;
    for (int i = 0; i < 16; ++i) bits |= static_cast<unsigned>(a.lane[i]) << i;
    return bits;
}
inline Lanes select(const Mask& m, const Lanes& a, const Lanes& b) {
    Lanes out;
    FOURD_PER_LANE(m.lane[i] ? a.lane[i] : b.lane[i]);
}
inline Lanes keep(const Mask& m, const Lanes& a) {
    Lanes out;
    FOURD_PER_LANE(m.lane[i] ? a.lane[i] : 0.0f);
}
inline bool any(const Mask& a) {
    bool out = false;
    for (const bool lane : a.lane) out = out || lane;
    return out;
}
inline void store_packed(std::uint32_t* to, const Lanes* bytes) {
    for (int i = 0; i < 16; ++i) {
        to[i] = 0;
        for (int c = 0; c < 4; ++c) to[i] |= static_cast<std::uint32_t>(bytes[c].lane[i]) << (8 * c);
    }
}

#undef FOURD_PER_LANE

#endif

// Returns the sum of all lanes: adds lanes i and i + 8, then i and i + 4, then i and i + 2, then i and i + 1.
inline float sum(Lanes a) {
    float v[16];
    store(v, a);
    for (int half = 8; half > 0; half /= 2) {
        for (int lane = 0; lane < half; ++lane) v[lane] += v[lane + half];
    }
    return v[0];
}

// Writes the sums of several Lanes, computed four at a time, with the same order of additions as in sum().
inline void store_sums(const Lanes* from, int count, float* to) {
    int k = 0;
#if defined(FOURD_SUM_OF_QUARTERS)
    for (; k + 4 <= count; k += 4) {
        const __m128 a = sum_of_quarters(from[k]), b = sum_of_quarters(from[k + 1]);
        const __m128 c = sum_of_quarters(from[k + 2]), d = sum_of_quarters(from[k + 3]);
        const __m128 ab = _mm_add_ps(_mm_unpacklo_ps(a, b), _mm_unpackhi_ps(a, b));
        const __m128 cd = _mm_add_ps(_mm_unpacklo_ps(c, d), _mm_unpackhi_ps(c, d));
        _mm_storeu_ps(to + k, _mm_add_ps(_mm_movelh_ps(ab, cd), _mm_movehl_ps(cd, ab)));
    }
#endif
    for (; k < count; ++k) to[k] = sum(from[k]);
}

// Returns the largest value of all lanes.
inline float max_lane(Lanes a) {
    float v[16];
    store(v, a);
    for (int half = 8; half > 0; half /= 2) {
        for (int lane = 0; lane < half; ++lane) v[lane] = v[lane] > v[lane + half] ? v[lane] : v[lane + half];
    }
    return v[0];
}

// The overload of constant() for Lanes, so that the same template works on floats and on Lanes. The pointer argument
// only selects the overload.
inline Lanes constant(float value, const Lanes*) { return broadcast(value); }
