#include "antialias/cuda/antialias.h"

#include "antialias/cuda/places.h"
#include "antialias/pairs.h"
#include "device/arena.h"
#include "device/clear.h"
#include "device/executor.h"

namespace fourd::antialias::cuda {
namespace {

struct FindCrossings {
    Plan plan;
    std::uint8_t* codes;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place place(plan.images, index);
        const View view(plan, place.image);
        Code code = 0;
        if (place.column + 1 < view.width) code |= analyse(view, {place.row, place.column, 0});
        if (place.row + 1 < view.height) code |= analyse(view, {place.row, place.column, 1});
        codes[index] = static_cast<std::uint8_t>(code);
    }
};

// A pixel forms four pairs with its neighbours. Calls body(blend) for each of these pairs that a silhouette edge
// crosses, in the order of the CPU kernel.
template <typename Body>
FOURD_DEVICE static inline void for_crossings(const View& view, const Place& place, const std::uint8_t* codes,
                                              const Body& body) {
    const Pair pairs[4] = {{place.row - 1, place.column, 1},
                           {place.row, place.column - 1, 0},
                           {place.row, place.column, 0},
                           {place.row, place.column, 1}};
    for (const Pair& pair : pairs) {
        if (pair.row < 0 || pair.column < 0) continue;
        const Code code = codes[view.pixel(pair.row, pair.column)];
        if (edge_of(code, pair.axis) != 0 && has_owner(view, pair, code)) body(Blend(view, pair, code));
    }
}

struct BlendPixel {
    Plan plan;
    const std::uint8_t* codes;
    float* out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place place(plan.images, index);
        const View view(plan, place.image);
        const float* colours = plan.images.colours;
        const std::size_t at = index * view.channels;
        for (int c = 0; c < view.channels; ++c) out[at + c] = colours[at + c];
        for_crossings(view, place, codes, [&](const Blend& blend) {
            if (blend.changed != index) return;
            const std::size_t from = blend.source * view.channels;
            for (int c = 0; c < view.channels; ++c) {
                out[at + c] += blend.crossing.weight * (colours[from + c] - colours[at + c]);
            }
        });
    }
};

struct BlendColoursBackward {
    Plan plan;
    Gradients gradients;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place place(plan.images, index);
        const View view(plan, place.image);
        const std::size_t at = index * view.channels;
        for (int c = 0; c < view.channels; ++c) gradients.colours[at + c] = gradients.gradient[at + c];
        for_crossings(view, place, gradients.codes, [&](const Blend& blend) {
            if (blend.changed != index && blend.source != index) return;
            const float weight = blend.source == index ? blend.crossing.weight : -blend.crossing.weight;
            const float* upstream = gradients.gradient + blend.changed * view.channels;
            for (int c = 0; c < view.channels; ++c) gradients.colours[at + c] += weight * upstream[c];
        });
    }
};

struct BlendPositionsBackward {
    Plan plan;
    Gradients gradients;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Code code = gradients.codes[index];
        if (code == 0) return;
        const Place place(plan.images, index);
        const View view(plan, place.image);
        for (int axis = 0; axis < 2; ++axis) {
            const Pair pair{place.row, place.column, axis};
            if (edge_of(code, axis) == 0 || !has_owner(view, pair, code)) continue;
            const Blend blend(view, pair, code);
            if (!blend.crossing.differentiable) continue;
            const float factor = crossing_gradient(view, blend, gradients.gradient) * gradients.boost;
            for (int k = 0; k < 2; ++k) {
                const Vertex& slope = blend.crossing.slope[k];
                float* to = gradients.positions + 4 * (view.first_vertex + blend.crossing.vertex[k]);
                device::atomic_add(to, factor * slope.x);
                device::atomic_add(to + 1, factor * slope.y);
                device::atomic_add(to + 3, factor * slope.w);
            }
        }
    }
};

}  // namespace

std::size_t workspace_bytes(const Mesh& mesh, std::size_t images) {
    device::Arena arena(nullptr);
    arena.take<std::uint8_t>(instances_of(mesh, images) * mesh.triangle_count);
    return arena.bytes();
}

void blend(const Mesh& mesh, const Images& images, void* workspace, float* out, std::uint8_t* codes, void* stream) {
    const device::Executor executor(stream);
    const std::size_t flags = instances_of(mesh, images.count) * mesh.triangle_count;
    std::uint8_t* const silhouettes = device::Arena(workspace).take<std::uint8_t>(flags);
    const Plan plan{mesh, images, silhouettes};
    const std::size_t pixels = images.count * images.pixels();
    executor.for_each(flags, FindSilhouettes{mesh, silhouettes});
    executor.for_each(pixels, FindCrossings{plan, codes});
    executor.for_each(pixels, BlendPixel{plan, codes, out});
}

void blend_backward(const Mesh& mesh, const Images& images, const Gradients& gradients, void* stream) {
    const device::Executor executor(stream);
    const Plan plan{mesh, images, nullptr};
    const std::size_t pixels = images.count * images.pixels();
    if (gradients.colours) executor.for_each(pixels, BlendColoursBackward{plan, gradients});
    if (!gradients.positions) return;
    executor.for_each(4 * instances_of(mesh, images.count) * mesh.vertices, device::Clear{gradients.positions});
    executor.for_each(pixels, BlendPositionsBackward{plan, gradients});
}

}  // namespace fourd::antialias::cuda
