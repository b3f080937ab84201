#include "rasterize/rasterize.h"

#include <algorithm>
#include <memory>

#include "common/pages.h"
#include "common/team.h"
#include "meshes/tile_slots.h"
#include "rasterize/cpu/bins.h"
#include "rasterize/cpu/loops.h"
#include "tiles/run_tiles.h"

namespace fourd::rasterize {
namespace {

static_assert(kTile == meshes::kTile, "the rasterizer and the sums of gradients need tiles of equal size");

// The memory of one worker.
struct Scratch {
    Buffer<float> values, sums;
    Buffer<std::uint32_t> references;
    std::unique_ptr<meshes::TileSlots> slots;

    Records records(std::size_t count) {
        // The spare records are needed because the last batch of records may extend beyond the last triangle.
        constexpr std::size_t kSpare = 16;
        const std::size_t needed = std::max<std::size_t>(count + kSpare, 256);
        if (needed > references.size()) {
            references.require(needed);
            values.require(Records::kFields * references.size());
        }
        return {values.data(), references.data(), references.size()};
    }
};

struct Place {
    int column, row;

    Place(int tile, int columns) : column(tile % columns * kTile), row(tile / columns * kTile) {}
};

}  // namespace

void rasterize(const Query& query, const float* previous, float* rast, float* rast_db) {
    const Loops& loops = select_loops(query.simd);
    const std::size_t image_size = 4 * query.pixels();
    prefer_huge_pages(rast, image_size * query.images * sizeof(float));
    if (rast_db != nullptr) prefer_huge_pages(rast_db, image_size * query.images * sizeof(float));
    Team team(query.threads);
    std::vector<Scratch> scratch(team.size());
    Bins bins;
    const int group = Bins::group_size(query);
    for (int first = 0; first < query.images; first += group) {
        bins.fill(query, first, std::min(query.images, first + group), team);
        tiles::run_tiles(team, 0, bins.tiles(), [&](int index, int worker) {
            const std::size_t image = static_cast<std::size_t>(first + index / bins.tiles_per_image());
            const Place place(index % bins.tiles_per_image(), bins.columns());
            const Tile tile{make_screen(query.width, query.height),
                            query.pos_of(image),
                            query.tri,
                            bins.pieces(index),
                            bins.count(index),
                            place.column,
                            place.row,
                            scratch[worker].records(bins.count(index)),
                            previous == nullptr ? nullptr : previous + image * image_size,
                            rast + image * image_size,
                            rast_db == nullptr ? nullptr : rast_db + image * image_size};
            loops.rasterize(tile);
        });
    }
}

void rasterize_backward(const Query& query, const float* rast, const float* grad_rast, const float* grad_db,
                        float* grad_pos) {
    const Loops& loops = select_loops(query.simd);
    const std::size_t image_size = 4 * query.pixels();
    Team team(query.threads);
    std::vector<Scratch> scratch(team.size());
    const meshes::IdImage shape{nullptr, query.width, query.height, query.triangles};
    std::vector<meshes::TileValues> values(static_cast<std::size_t>(shape.tiles()) * query.images);
    team.run(static_cast<int>(values.size()), [&](int index, int worker) {
        Scratch& memory = scratch[worker];
        if (memory.slots == nullptr) memory.slots = std::make_unique<meshes::TileSlots>();
        meshes::TileSlots& slots = *memory.slots;
        const std::size_t image = static_cast<std::size_t>(index / shape.tiles());
        const Place place(index % shape.tiles(), shape.columns());
        slots.fill({rast + image * image_size, query.width, query.height, query.triangles}, place.column, place.row);
        if (slots.count() == 0) return;
        const std::size_t count = static_cast<std::size_t>(slots.count());
        memory.sums.require(kSumStride * count);
        values[index].triangles.assign(slots.triangles(), slots.triangles() + count);
        values[index].values = Buffer<float>(12 * count);
        loops.backward({make_screen(query.width, query.height), query.pos_of(image), query.vertices, query.tri,
                        slots.triangles(), slots.count(), slots.slot_of(), place.column, place.row, memory.records(count),
                        memory.sums.data(), grad_rast + image * image_size,
                        grad_db == nullptr ? nullptr : grad_db + image * image_size, values[index].values.data()});
    });
    meshes::sum_by_vertex(values, query.tri, {query.vertices, 4, query.images, query.image_stride == 0}, grad_pos,
                          team);
}

}  // namespace fourd::rasterize
