// Computes the colours of batches of points, in loops that compilers vectorise.
#include <cmath>
#include <cstring>

#include "common/half.h"
#include "common/inline.h"
#include "shade/cpu/loops.h"
#include "shade/maths.h"

#if defined(__AVX2__) && defined(__F16C__) && defined(__FMA__)
#define FOURD_SHADE_VECTORS
#include <immintrin.h>
#endif

namespace fourd::shade::FOURD_SIMD {
namespace {

// Computes basis[k][i], the value of spherical harmonic k in the direction from the camera to point i.
FOURD_INLINE void fill_basis(const float* xyz, int count, const double* centre, float (*basis)[kBlock]) {
    float dx[kBlock], dy[kBlock], dz[kBlock];
    for (int i = 0; i < count; ++i) {
        // The subtraction uses double precision, because a camera may be far from the origin but near the point.
        dx[i] = static_cast<float>(xyz[3 * i] - centre[0]);
        dy[i] = static_cast<float>(xyz[3 * i + 1] - centre[1]);
        dz[i] = static_cast<float>(xyz[3 * i + 2] - centre[2]);
    }
    for (int i = 0; i < count; ++i) {
        harmonics(dx[i], dy[i], dz[i], [&](int k, float value) FOURD_INLINE_LAMBDA { basis[k][i] = value; });
    }
}

#ifdef FOURD_SHADE_VECTORS

// Transposes a matrix of 8 harmonics at 8 points.
FOURD_INLINE void transpose(const float (*basis)[kBlock], int first, __m256* rows) {
    __m256 a[8], b[8];
    for (int k = 0; k < 8; ++k) a[k] = _mm256_loadu_ps(basis[k] + first);
    for (int k = 0; k < 8; k += 2) {
        b[k] = _mm256_unpacklo_ps(a[k], a[k + 1]);
        b[k + 1] = _mm256_unpackhi_ps(a[k], a[k + 1]);
    }
    for (int k = 0; k < 8; k += 4) {
        a[k] = _mm256_shuffle_ps(b[k], b[k + 2], 0x44);
        a[k + 1] = _mm256_shuffle_ps(b[k], b[k + 2], 0xee);
        a[k + 2] = _mm256_shuffle_ps(b[k + 1], b[k + 3], 0x44);
        a[k + 3] = _mm256_shuffle_ps(b[k + 1], b[k + 3], 0xee);
    }
    for (int k = 0; k < 4; ++k) {
        rows[k] = _mm256_permute2f128_ps(a[k], a[k + 4], 0x20);
        rows[k + 4] = _mm256_permute2f128_ps(a[k], a[k + 4], 0x31);
    }
}

FOURD_INLINE __m256 halves(const std::uint16_t* from) {
    return _mm256_cvtph_ps(_mm_loadu_si128(reinterpret_cast<const __m128i*>(from)));
}

// Writes to `colour` (count, 3), for each channel, the dot product of the SH coefficients and the basis.
FOURD_INLINE void dot_harmonics(const std::uint16_t* sh, int count, const float (*basis)[kBlock], float* colour) {
    for (int first = 0; first < count; first += 8) {
        __m256 low[8], high[8];
        transpose(basis, first, low);
        transpose(basis + 8, first, high);
        for (int i = first; i < count && i < first + 8; ++i) {
            const std::uint16_t* row = sh + 3 * kTerms * static_cast<std::size_t>(i);
            __m256 part[3];
            for (int c = 0; c < 3; ++c) {
                part[c] = _mm256_mul_ps(halves(row + kTerms * c), low[i - first]);
                part[c] = _mm256_fmadd_ps(halves(row + kTerms * c + 8), high[i - first], part[c]);
            }
            const __m256 pairs = _mm256_hadd_ps(_mm256_hadd_ps(part[0], part[1]), _mm256_hadd_ps(part[2], part[2]));
            float sums[4];
            _mm_storeu_ps(sums, _mm_add_ps(_mm256_castps256_ps128(pairs), _mm256_extractf128_ps(pairs, 1)));
            std::memcpy(colour + 3 * i, sums, 3 * sizeof(float));
        }
    }
}

#else

// Writes to `colour` (count, 3), for each channel, the dot product of the SH coefficients and the basis.
FOURD_INLINE void dot_harmonics(const std::uint16_t* sh, int count, const float (*basis)[kBlock], float* colour) {
    for (int i = 0; i < count; ++i) {
        float direction[kTerms];
        for (int k = 0; k < kTerms; ++k) direction[k] = basis[k][i];
        for (int channel = 0; channel < 3; ++channel) {
            const std::uint16_t* row = sh + (3 * static_cast<std::size_t>(i) + channel) * kTerms;
            float part[kTerms];
            for (int k = 0; k < kTerms; ++k) part[k] = from_half(row[k]) * direction[k];
            for (int half = kTerms / 2; half > 0; half /= 2)
                for (int k = 0; k < half; ++k) part[k] += part[k + half];
            colour[3 * i + channel] = part[0];
        }
    }
}

#endif

struct Rgb {
    float channel[3];
};

// Computes the weighted sum of the colours (0 to 255) of the chosen views, and returns the sum of the weights. The
// weight of a colour is the weight of its view times the point's blend weight for this view.
FOURD_INLINE float weighted_sum(const Points& points, std::size_t row, const Settings& settings, Rgb* out) {
#ifdef FOURD_SHADE_VECTORS
    const std::size_t last = points.count * points.views - 1;
    __m128 sum = _mm_setzero_ps();
    float total = 0;
    for (int v = 0; v < settings.chosen_count; ++v) {
        const std::size_t at = row + static_cast<std::size_t>(settings.chosen[v]);
        std::uint32_t bytes = 0;  // The lowest three bytes are used; the fourth belongs to the next view.
        if (at < last) {
            std::memcpy(&bytes, points.rgb + 3 * at, 4);
        } else {
            std::memcpy(&bytes, points.rgb + 3 * at, 3);
        }
        const __m128 rgb = _mm_cvtepi32_ps(_mm_cvtepu8_epi32(_mm_cvtsi32_si128(static_cast<int>(bytes))));
        const float weight = settings.view_weights[v] * _cvtsh_ss(points.weights[at]);
        sum = _mm_fmadd_ps(_mm_set1_ps(weight), rgb, sum);
        total += weight;
    }
    float channels[4];
    _mm_storeu_ps(channels, sum);
    std::memcpy(out->channel, channels, sizeof out->channel);
    return total;
#else
    float total = 0;
    *out = {{0, 0, 0}};
    for (int v = 0; v < settings.chosen_count; ++v) {
        const std::size_t at = row + static_cast<std::size_t>(settings.chosen[v]);
        const float weight = settings.view_weights[v] * from_half(points.weights[at]);
        total += weight;
        for (int c = 0; c < 3; ++c) out->channel[c] += weight * points.rgb[3 * at + c];
    }
    return total;
#endif
}

// Computes the sum of the colours of the chosen views, weighted only by the view weights, and returns the sum of the
// view weights. The result is used for points at which all chosen views have the blend weight 0.
FOURD_INLINE float plain_sum(const Points& points, std::size_t row, const Settings& settings, Rgb* out) {
    float total = 0;
    *out = {{0, 0, 0}};
    for (int v = 0; v < settings.chosen_count; ++v) {
        const std::uint8_t* rgb = points.rgb + 3 * (row + static_cast<std::size_t>(settings.chosen[v]));
        total += settings.view_weights[v];
        for (int c = 0; c < 3; ++c) out->channel[c] += settings.view_weights[v] * rgb[c];
    }
    return total;
}

// Blends the colours of the chosen views with normalised weights, and adds the result to colour (count, 3).
FOURD_INLINE void add_blend(const Points& points, std::size_t first, int count, const Settings& settings,
                            float* colour) {
    if (settings.chosen_count == 0) return;
    for (int i = 0; i < count; ++i) {
        const std::size_t row = (first + static_cast<std::size_t>(i)) * points.views;
        Rgb rgb;
        float total = weighted_sum(points, row, settings, &rgb);
        if (!(total > 0)) total = plain_sum(points, row, settings, &rgb);
        const float scale = 1.0f / (255.0f * total);
        for (int c = 0; c < 3; ++c) colour[3 * i + c] += scale * rgb.channel[c];
    }
}

FOURD_INLINE void shade_block(const Points& points, std::size_t first, int count, const Settings& settings,
                              float* out) {
    float basis[kTerms][kBlock];
    fill_basis(points.xyz + 3 * first, count, settings.centre, basis);
    float* colour = out + 3 * first;
    dot_harmonics(points.sh + 3 * kTerms * first, count, basis, colour);
    for (int i = 0; i < 3 * count; ++i) colour[i] = settings.sh_base + settings.sh_range * fast_tanh(colour[i]);
    add_blend(points, first, count, settings, colour);
}

void shade_range(const Points& points, std::size_t begin, std::size_t end, const Settings& settings, float* out) {
    for (std::size_t first = begin; first < end; first += kBlock) {
        const std::size_t left = end - first;
        shade_block(points, first, left < kBlock ? static_cast<int>(left) : kBlock, settings, out);
    }
}

}  // namespace

const Loops loops = {shade_range};

}  // namespace fourd::shade::FOURD_SIMD
