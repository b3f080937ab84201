#include "interpolate/interpolate.h"

#include <algorithm>
#include <memory>
#include <vector>

#include "common/pages.h"
#include "common/team.h"
#include "interpolate/cpu/loops.h"
#include "meshes/tile_slots.h"

namespace fourd::interpolate {
namespace {

static_assert(kTile == meshes::kTile, "the interpolation and the sums of gradients need tiles of equal size");

void prefer_huge(float* values, std::size_t count) {
    if (values != nullptr) prefer_huge_pages(values, count * sizeof(float));
}

}  // namespace

void interpolate(const Query& query, float* out, float* out_da) {
    constexpr std::size_t kChunk = 16384;  // Number of pixels per task.
    const Loops& loops = select_loops(query.simd);
    const std::size_t pixels = query.pixels(), all = pixels * query.images;
    const std::size_t chunks = (pixels + kChunk - 1) / kChunk;
    prefer_huge(out, all * query.channels);
    prefer_huge(out_da, 2 * all * query.diff_count);
    Team team(query.threads);
    team.run(static_cast<int>(chunks * query.images), [&](int task, int) {
        const std::size_t image = task / chunks, begin = task % chunks * kChunk;
        loops.forward(query, query.attr_of(image), image * pixels + begin,
                      image * pixels + std::min(pixels, begin + kChunk), out, out_da);
    });
}

void interpolate_backward(const Query& query, const Gradients& gradients) {
    const Loops& loops = select_loops(query.simd);
    const std::size_t pixels = query.pixels();
    prefer_huge(gradients.rast, 4 * pixels * query.images);
    prefer_huge(gradients.rast_db, 4 * pixels * query.images);
    Team team(query.threads);
    std::vector<std::unique_ptr<meshes::TileSlots>> slots_by_worker(team.size());
    const meshes::IdImage shape{nullptr, query.width, query.height, query.triangles};
    std::vector<meshes::TileValues> values(static_cast<std::size_t>(shape.tiles()) * query.images);
    team.run(static_cast<int>(values.size()), [&](int index, int worker) {
        if (slots_by_worker[worker] == nullptr) slots_by_worker[worker] = std::make_unique<meshes::TileSlots>();
        meshes::TileSlots& slots = *slots_by_worker[worker];
        const std::size_t image = static_cast<std::size_t>(index / shape.tiles());
        const int column = index % shape.tiles() % shape.columns() * kTile;
        const int row = index % shape.tiles() / shape.columns() * kTile;
        slots.fill({query.rast + 4 * image * pixels, query.width, query.height, query.triangles}, column, row);
        meshes::TileValues& out = values[index];
        if (gradients.attr != nullptr) {
            const std::size_t size = 3 * query.channels * static_cast<std::size_t>(slots.count());
            out.triangles.assign(slots.triangles(), slots.triangles() + slots.count());
            out.values = Buffer<float>(size);
            std::fill_n(out.values.data(), size, 0.0f);
        }
        loops.backward(query,
                       {query.attr_of(image), slots.triangles(), slots.slot_of(), column, row, image * pixels,
                        gradients.attr == nullptr ? nullptr : out.values.data()},
                       gradients);
    });
    if (gradients.attr == nullptr) return;
    meshes::sum_by_vertex(values, query.tri, {query.vertices, query.channels, query.images, query.image_stride == 0},
                          gradients.attr, team);
}

}  // namespace fourd::interpolate
