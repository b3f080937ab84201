// Finds the discs that rays hit. All discs of a block are tested at once.
#include "rays/cpu/disc_loops.h"

#if defined(FOURD_X86)
#include <immintrin.h>
#endif

#include <cstring>

#include "common/inline.h"
#include "rays/disc_maths.h"
#include "rays/maths.h"

namespace fourd::rays::discs::FOURD_SIMD {
namespace {

#include "rays/cpu/lanes.inc"
#include "rays/cpu/traversal.inc"

FOURD_INLINE void widen(const DiscRay<float>& ray, DiscRay<Lanes>* out) {
    for (int i = 0; i < 3; ++i) {
        out->origin[i] = broadcast(ray.origin[i]);
        out->along[i] = broadcast(ray.along[i]);
        out->normal[i] = broadcast(ray.normal[i]);
    }
}

// Tests the discs of a block. Adds to `nearest` the discs that the ray hits at a t' (rays/maths.h) between `first` and
// `last`.
FOURD_INLINE void add_discs(const DiscRay<Lanes>& ray, const DiscBlock& block, float first, float last,
                            NearestDiscs* nearest) {
    const Lanes centre[3] = {load(block.centre[0]), load(block.centre[1]), load(block.centre[2])};
    Lanes t, alpha;
    meet_disc(ray, centre, load(block.inverse_square), load(block.density), broadcast(1.0f), &t, &alpha);
    unsigned bits = is_less(broadcast(0.0f), alpha) & is_less_or_equal(broadcast(first), t) &
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

void composite(const DiscTreeView& tree, const Rays& rays, const DiscPicture& picture, std::size_t begin,
               std::size_t end) {
    for (std::size_t index = begin; index < end; ++index) {
        NearestDiscs nearest(picture.layers);
        WideRay ray;
        DiscRay<float> disc_ray;
        if (prepare_ray(tree.node_count, tree.magnitude, rays, index, &ray) &&
            prepare_discs(ray.ray, rays.directions + 3 * index, picture.facing, &disc_ray)) {
            DiscRay<Lanes> wide;
            widen(disc_ray, &wide);
            const float first = first_of(ray.ray);
            traverse(tree.nodes, tree.blocks, ray, first, last_of(ray.ray, ray.ray.t_max),
                     [&](const DiscBlock& block, float* last) FOURD_INLINE_LAMBDA {
                         add_discs(wide, block, first, *last, &nearest);
                         *last = nearest.bound(*last);
                         return false;
                     });
        }
        nearest.composite(picture.colours, picture.rgba + 4 * index);
    }
}

}  // namespace

const Loops loops = {composite};

}  // namespace fourd::rays::discs::FOURD_SIMD
