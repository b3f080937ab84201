// The maths of discs along rays, shared by every backend.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/host_device.h"
#include "common/inline.h"
#include "rays/discs.h"
#include "rays/maths.h"
#include "rays/rays.h"

namespace fourd::rays {

// A ray that is prepared for intersections with discs. `Number` is float, or a vector of floats with equal elements.
template <typename Number>
struct DiscRay {
    Number origin[3];
    Number along[3];   // The scaled direction (Ray in rays/maths.h).
    Number normal[3];  // The normal of the discs, divided by the dot product of the normal and the scaled direction.
};

// Prepares a ray for intersections with discs, and writes it to `out`. `direction` is the original, unscaled direction
// of the ray. `facing` is the normal of all discs, or null to use the direction of the ray. Returns false if the ray is
// parallel to the discs.
FOURD_HD FOURD_INLINE bool prepare_discs(const Ray& ray, const float* direction, const float* facing,
                                         DiscRay<float>* out) {
    float product = 0.0f;
    for (int i = 0; i < 3; ++i) {
        out->origin[i] = ray.origin[i];
        out->along[i] = direction[i] * ray.scale;
        out->normal[i] = facing != nullptr ? facing[i] : out->along[i];
        product += out->normal[i] * out->along[i];
    }
    if (!(absolute(product) > 0.0f)) return false;
    for (int i = 0; i < 3; ++i) out->normal[i] = out->normal[i] / product;
    return true;
}

// Computes the t' (rays/maths.h) at which the ray meets the plane of a disc, and the alpha of the disc at this point.
// Outside the disc, the alpha is 0 or negative.
template <typename Number>
FOURD_HD FOURD_INLINE void meet_disc(const DiscRay<Number>& ray, const Number (&centre)[3],
                                     const Number& inverse_square, const Number& density, const Number& one, Number* t,
                                     Number* alpha) {
    Number away[3] = {centre[0] - ray.origin[0], centre[1] - ray.origin[1], centre[2] - ray.origin[2]};
    *t = away[0] * ray.normal[0] + away[1] * ray.normal[1] + away[2] * ray.normal[2];
    for (int i = 0; i < 3; ++i) away[i] = away[i] - ray.along[i] * *t;
    const Number square = away[0] * away[0] + away[1] * away[1] + away[2] * away[2];
    *alpha = density * (one - square * inverse_square);
}

// The nearest discs that a ray has hit so far, in the order of (t', index).
struct NearestDiscs {
    int layers, found = 0;
    float t[kMaxDiscLayers], alpha[kMaxDiscLayers];
    std::int32_t index[kMaxDiscLayers];

    FOURD_HD FOURD_INLINE explicit NearestDiscs(int most) : layers(most) {}

    FOURD_HD FOURD_INLINE void add(float new_t, float new_alpha, std::int32_t new_index) {
        if (found == layers && !is_after(t[found - 1], index[found - 1], new_t, new_index)) return;
        int at = found < layers ? found++ : found - 1;
        for (; at > 0 && is_after(t[at - 1], index[at - 1], new_t, new_index); --at) {
            t[at] = t[at - 1];
            alpha[at] = alpha[at - 1];
            index[at] = index[at - 1];
        }
        t[at] = new_t;
        alpha[at] = new_alpha;
        index[at] = new_index;
    }

    // Returns the largest t' at which a disc can still be added, but at most `last`.
    FOURD_HD FOURD_INLINE float bound(float last) const {
        return found == layers && t[found - 1] < last ? t[found - 1] : last;
    }

    // Composites the discs front to back. Writes the premultiplied colour, followed by alpha, to `rgba`.
    FOURD_HD FOURD_INLINE void composite(const float* colours, float* rgba) const {
        float transmittance = 1.0f;
        for (int c = 0; c < 3; ++c) rgba[c] = 0.0f;
        for (int k = 0; k < found; ++k) {
            const float weight = transmittance * alpha[k];
            const float* const colour = colours + 3 * static_cast<std::size_t>(index[k]);
            for (int c = 0; c < 3; ++c) rgba[c] += weight * colour[c];
            transmittance *= 1.0f - alpha[k];
        }
        rgba[3] = 1.0f - transmittance;
    }
};

}  // namespace fourd::rays
