// Shading of a short run of points, as plain loops that compilers turn into vectors. The instruction
// set is chosen by the translation unit or function that this is inlined into.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>

#include "common/half.h"
#include "common/inline.h"
#include "shade/shade.h"

namespace fourd::shade {

constexpr int kBlock = 64;  // points whose intermediate values stay in the first-level cache

// tanh to 4e-7: a rational function (Eigen's coefficients) on the interval where float tanh is not 1.
FOURD_INLINE float fast_tanh(float x) {
    x = std::min(std::max(x, -7.90531110763549805f), 7.90531110763549805f);
    const float s = x * x;
    float p = -2.76076847742355e-16f;
    p = p * s + 2.00018790482477e-13f;
    p = p * s + -8.60467152213735e-11f;
    p = p * s + 5.12229709037114e-08f;
    p = p * s + 1.48572235717979e-05f;
    p = p * s + 6.37261928875436e-04f;
    p = p * s + 4.89352455891786e-03f;
    float q = 1.19825839466702e-06f;
    q = q * s + 1.18534705686654e-04f;
    q = q * s + 2.26843463243900e-03f;
    q = q * s + 4.89352518554385e-03f;
    return x * p / q;
}

// basis[k][i]: harmonic k in the direction from the camera to point i.
FOURD_INLINE void fill_basis(const float* xyz, int count, const double* centre, float (*basis)[kBlock]) {
    float dx[kBlock], dy[kBlock], dz[kBlock];
    for (int i = 0; i < count; ++i) {
        const double x = xyz[3 * i] - centre[0];
        const double y = xyz[3 * i + 1] - centre[1];
        const double z = xyz[3 * i + 2] - centre[2];
        const double scale = 1.0 / std::max(std::sqrt(x * x + y * y + z * z), 1e-12);
        dx[i] = static_cast<float>(x * scale);
        dy[i] = static_cast<float>(y * scale);
        dz[i] = static_cast<float>(z * scale);
    }
    for (int i = 0; i < count; ++i) {
        const float x = dx[i], y = dy[i], z = dz[i];
        const float xx = x * x, yy = y * y, zz = z * z;
        basis[0][i] = 0.28209479177387814f;
        basis[1][i] = -0.4886025119029199f * y;
        basis[2][i] = 0.4886025119029199f * z;
        basis[3][i] = -0.4886025119029199f * x;
        basis[4][i] = 1.0925484305920792f * x * y;
        basis[5][i] = -1.0925484305920792f * y * z;
        basis[6][i] = 0.31539156525252005f * (2 * zz - xx - yy);
        basis[7][i] = -1.0925484305920792f * x * z;
        basis[8][i] = 0.5462742152960396f * (xx - yy);
        basis[9][i] = -0.5900435899266435f * y * (3 * xx - yy);
        basis[10][i] = 2.890611442640554f * x * y * z;
        basis[11][i] = -0.4570457994644658f * y * (4 * zz - xx - yy);
        basis[12][i] = 0.3731763325901154f * z * (2 * zz - 3 * xx - 3 * yy);
        basis[13][i] = -0.4570457994644658f * x * (4 * zz - xx - yy);
        basis[14][i] = 1.445305721320277f * z * (xx - yy);
        basis[15][i] = -0.5900435899266435f * x * (xx - 3 * yy);
    }
}

// colour (count, 3) = sh . basis
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

// colour (count, 3) += the chosen views' colours, by weights that are made to sum to 1.
FOURD_INLINE void add_blend(const Points& points, std::size_t first, int count, const Settings& settings,
                            float* colour) {
    const int chosen = settings.chosen_count;
    if (chosen == 0) return;
    for (int i = 0; i < count; ++i) {
        const std::size_t row = (first + static_cast<std::size_t>(i)) * points.views;
        float total = 0, red = 0, green = 0, blue = 0;
        float red_even = 0, green_even = 0, blue_even = 0;
        for (int v = 0; v < chosen; ++v) {
            const std::size_t at = row + static_cast<std::size_t>(settings.chosen[v]);
            const float weight = from_half(points.weights[at]);
            const std::uint8_t* rgb = points.rgb + 3 * at;
            total += weight;
            red += weight * rgb[0];
            green += weight * rgb[1];
            blue += weight * rgb[2];
            red_even += rgb[0];
            green_even += rgb[1];
            blue_even += rgb[2];
        }
        const bool trusted = total > 0;
        const float scale = 1.0f / (255.0f * (trusted ? total : static_cast<float>(chosen)));
        colour[3 * i] += scale * (trusted ? red : red_even);
        colour[3 * i + 1] += scale * (trusted ? green : green_even);
        colour[3 * i + 2] += scale * (trusted ? blue : blue_even);
    }
}

FOURD_INLINE void shade_block(const Points& points, std::size_t first, int count, const Settings& settings,
                              float* out) {
    float basis[kTerms][kBlock];
    fill_basis(points.xyz + 3 * first, count, settings.centre, basis);
    float* colour = out + 3 * first;
    dot_harmonics(points.sh + 3 * kTerms * first, count, basis, colour);
    for (int i = 0; i < 3 * count; ++i)
        colour[i] = settings.sh_base + settings.sh_range * fast_tanh(colour[i]);
    add_blend(points, first, count, settings, colour);
}

}  // namespace fourd::shade
