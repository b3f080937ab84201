#include "rays/cuda/discs.h"

#include "device/executor.h"
#include "rays/cuda/traversal.h"
#include "rays/disc_maths.h"
#include "rays/maths.h"

namespace fourd::rays::cuda {
namespace {

// Tests the discs of a block. Adds to `nearest` the discs that the ray hits at a t' (rays/maths.h) between `first` and
// `last`.
FOURD_DEVICE static void add_discs(const DiscRay<float>& ray, const DiscBlock& block, float first, float last,
                                   NearestDiscs* nearest) {
    for (int lane = 0; lane < kWidth; ++lane) {
        const float centre[3] = {block.centre[0][lane], block.centre[1][lane], block.centre[2][lane]};
        float t, alpha;
        meet_disc(ray, centre, block.inverse_square[lane], block.density[lane], 1.0f, &t, &alpha);
        if (0.0f < alpha && first <= t && t <= last) nearest->add(t, alpha, block.index[lane]);
    }
}

struct Composite {
    DiscTreeView tree;
    Rays rays;
    DiscPicture picture;

    FOURD_DEVICE void operator()(std::size_t index) const {
        NearestDiscs nearest(picture.layers);
        Ray ray;
        DiscRay<float> disc_ray;
        if (prepare_ray(tree.node_count, tree.magnitude, rays, index, &ray) &&
            prepare_discs(ray, rays.directions + 3 * index, picture.facing, &disc_ray)) {
            const float first = first_of(ray), bound = last_of(ray, ray.t_max);
            const auto last = [&nearest, bound] { return nearest.bound(bound); };
            const auto visit = [&](const DiscBlock& block) {
                add_discs(disc_ray, block, first, last(), &nearest);
                return false;
            };
            traverse(tree.nodes, tree.blocks, ray, visit, last);
        }
        nearest.composite(picture.colours, picture.rgba + 4 * index);
    }
};

}  // namespace

void composite_discs(const DiscTreeView& tree, const Rays& rays, const DiscPicture& picture, void* stream) {
    device::Executor(stream).for_each(rays.count, Composite{tree, rays, picture});
}

}  // namespace fourd::rays::cuda
