// Hits of rays with discs. All discs of a block are tested at once.
#include "rays/cpu/disc_loops.h"

#if defined(FOURD_X86)
#include <immintrin.h>
#endif

#include <cstring>

#include "common/inline.h"
#include "rays/maths.h"

namespace fourd::rays::discs::FOURD_SIMD {
namespace {

#include "rays/cpu/lanes.inc"
#include "rays/cpu/traversal.inc"

// The nearest discs of a ray so far, in the order of (t', index).
struct Nearest {
    int layers, found = 0;
    float t[kMaxDiscLayers], alpha[kMaxDiscLayers];
    std::int32_t index[kMaxDiscLayers];

    explicit Nearest(int most) : layers(most) {}

    FOURD_INLINE void add(float new_t, float new_alpha, std::int32_t new_index) {
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
};

// A ray, its scaled direction, and the normal of the discs divided by its product with the direction.
struct DiscRay {
    WideRay wide;
    Lanes origin[3], along[3], normal[3];
    float first, last;
};

// Returns false if the ray is parallel to the discs.
FOURD_INLINE bool prepare_discs(const Rays& rays, std::size_t index, const float* facing, DiscRay* out) {
    const Ray& ray = out->wide.ray;
    float along[3], normal[3], product = 0.0f;
    for (int i = 0; i < 3; ++i) {
        along[i] = rays.directions[3 * index + i] * ray.scale;
        normal[i] = facing != nullptr ? facing[i] : along[i];
        product += normal[i] * along[i];
    }
    if (!(absolute(product) > 0.0f)) return false;
    for (int i = 0; i < 3; ++i) {
        out->origin[i] = broadcast(ray.origin[i]);
        out->along[i] = broadcast(along[i]);
        out->normal[i] = broadcast(normal[i] / product);
    }
    out->first = first_of(ray);
    out->last = last_of(ray, ray.t_max);
    return true;
}

// Adds the discs of a block that the ray hits between t' = first and t' = last.
FOURD_INLINE void add_discs(const DiscRay& ray, const DiscBlock& block, float last, Nearest* nearest) {
    Lanes away[3];
    for (int i = 0; i < 3; ++i) away[i] = load(block.centre[i]) - ray.origin[i];
    const Lanes t = away[0] * ray.normal[0] + away[1] * ray.normal[1] + away[2] * ray.normal[2];
    for (int i = 0; i < 3; ++i) away[i] = away[i] - ray.along[i] * t;
    const Lanes square = away[0] * away[0] + away[1] * away[1] + away[2] * away[2];
    const Lanes falloff = broadcast(1.0f) - square * load(block.inverse_square);
    const Lanes alpha = load(block.density) * falloff;
    unsigned bits = is_less(broadcast(0.0f), alpha) & is_less_or_equal(broadcast(ray.first), t) &
                    is_less_or_equal(t, broadcast(last));
    if (bits == 0) return;
    float all_t[kWidth], all_alpha[kWidth];
    store(all_t, t);
    store(all_alpha, alpha);
    for (; bits != 0; bits &= bits - 1) {
        const int lane = lowest_bit(bits);
        nearest->add(all_t[lane], all_alpha[lane], block.index[lane]);
    }
}

void composite(const DiscTree& tree, const Rays& rays, const DiscPicture& picture, std::size_t begin, std::size_t end) {
    for (std::size_t index = begin; index < end; ++index) {
        float* const out = picture.rgba + 4 * index;
        for (int c = 0; c < 4; ++c) out[c] = 0.0f;
        DiscRay ray;
        if (!prepare_ray(tree.nodes.size(), tree.magnitude, rays, index, &ray.wide) ||
            !prepare_discs(rays, index, picture.facing, &ray)) {
            continue;
        }
        Nearest nearest(picture.layers);
        traverse(tree.nodes.data(), tree.blocks.data(), ray.wide, ray.first, ray.last,
                 [&](const DiscBlock& block, float* last) FOURD_INLINE_LAMBDA {
                     add_discs(ray, block, *last, &nearest);
                     if (nearest.found == nearest.layers && nearest.t[nearest.found - 1] < *last) {
                         *last = nearest.t[nearest.found - 1];
                     }
                     return false;
                 });
        float transmittance = 1.0f;
        for (int k = 0; k < nearest.found; ++k) {
            const float weight = transmittance * nearest.alpha[k];
            const float* const colour = picture.colours + 3 * static_cast<std::size_t>(nearest.index[k]);
            for (int c = 0; c < 3; ++c) out[c] += weight * colour[c];
            transmittance *= 1.0f - nearest.alpha[k];
        }
        out[3] = 1.0f - transmittance;
    }
}

}  // namespace

const Loops loops = {composite};

}  // namespace fourd::rays::discs::FOURD_SIMD
