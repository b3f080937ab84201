#include <algorithm>
#include <cstring>
#include <vector>

#include "points/cpu/bins.h"
#include "points/cpu/tiles.h"

namespace fourd::points {
namespace {

Tile tile_at(const Cloud& cloud, const Settings& settings, const Bins& bins, int index) {
    Tile tile;
    tile.splats = bins.splats.data();
    tile.features = cloud.features;
    tile.entries = bins.entries.data() + bins.tile_begin[index];
    tile.count = bins.tile_begin[index + 1] - bins.tile_begin[index];
    tile.channels = cloud.channels;
    tile.layers = settings.layers;
    tile.transmittance_min = settings.transmittance_min;
    tile.column = index % bins.columns * kTile;
    tile.row = index / bins.columns * kTile;
    tile.width = settings.camera.width;
    tile.height = settings.camera.height;
    return tile;
}

// Each entry of the bins has a slot for what its tile finds out about its point. A point's slots
// lie side by side, so that they are merged in one order whatever thread filled them.
struct Slots {
    Buffer<std::size_t> begin;  // by point, and the end
};

Slots assign_slots(const Cloud& cloud, const Bins& bins) {
    Slots slots{Buffer<std::size_t>(cloud.count + 1)};
    std::size_t total = 0;
    for (std::size_t i = 0; i < cloud.count; ++i) {
        slots.begin[i] = total;
        if (bins.visible[i]) total += bins.reach(i);
    }
    slots.begin[cloud.count] = total;
    return slots;
}

// The slots of a tile's entries.
void slots_of_tile(const Tile& tile, const Bins& bins, const Slots& slots, Buffer<std::size_t>& out) {
    out.require(tile.count);
    for (std::size_t entry = 0; entry < tile.count; ++entry) {
        const std::uint32_t point = tile.entries[entry];
        out[entry] = slots.begin[point] + bins.rank(point, tile.column / kTile, tile.row / kTile);
    }
}

// How often the tile's entries meet its rows, at most.
std::size_t count_visits(const Tile& tile) {
    std::size_t visits = 0;
    for (std::size_t entry = 0; entry < tile.count; ++entry) {
        const Splat& splat = tile.splats[tile.entries[entry]];
        visits += std::min(splat.row_last, tile.row + kTile - 1) - std::max(splat.row_first, tile.row) + 1;
    }
    return visits;
}

struct Scratch {
    Buffer<std::size_t> slots;
    Buffer<float> transmittance;
    Buffer<std::uint64_t> tags;
};

constexpr std::size_t kPointsPerTask = 4096;

int tasks_of(std::size_t count) { return static_cast<int>((count + kPointsPerTask - 1) / kPointsPerTask); }

// Sums a point's slots in order and carries them to the point.
void gather_gradient(const Cloud& cloud, const Settings& settings, const Bins& bins, const Slots& slots,
                     const float* sums, std::size_t point, const CloudGradient& out) {
    const int width = 5 + cloud.channels;
    float total[5 + 32] = {};
    for (std::size_t slot = slots.begin[point]; slot < slots.begin[point + 1]; ++slot) {
        for (int k = 0; k < width; ++k) total[k] += sums[slot * width + k];
    }
    std::memcpy(out.features + point * cloud.channels, total + 5, cloud.channels * sizeof(float));
    if (bins.visible[point]) {
        const SplatGradient gradient = {total[0], total[1], total[2], total[3], total[4]};
        project_backward(settings.camera, bins.splats[point], gradient, cloud.density[point], out.xyz + 3 * point,
                         out.radius + point, out.density + point);
    } else {
        std::fill_n(out.xyz + 3 * point, 3, 0.0f);
        out.radius[point] = out.density[point] = 0.0f;
    }
}

}  // namespace

void render(const Cloud& cloud, const Settings& settings, const Image& out) {
    const TileKernels& kernels = tile_kernels(settings.simd);
    Team team(settings.threads);
    const Bins bins = bin_points(cloud, settings, team);
    team.run(bins.tiles(), [&](int index, int) { kernels.render(tile_at(cloud, settings, bins, index), out); });
}

void render_backward(const Cloud& cloud, const Settings& settings, const ImageGradient& gradient,
                     const CloudGradient& out) {
    const TileKernels& kernels = tile_kernels(settings.simd);
    Team team(settings.threads);
    const Bins bins = bin_points(cloud, settings, team);
    const Slots slots = assign_slots(cloud, bins);
    const std::size_t width = 5 + cloud.channels;
    Buffer<float> sums(bins.entries.size() * width);
    std::vector<Scratch> scratches(team.size());
    team.run(bins.tiles(), [&](int index, int worker) {
        const Tile tile = tile_at(cloud, settings, bins, index);
        Scratch& scratch = scratches[worker];
        slots_of_tile(tile, bins, slots, scratch.slots);
        for (std::size_t entry = 0; entry < tile.count; ++entry) {
            std::fill_n(sums.data() + scratch.slots[entry] * width, width, 0.0f);
        }
        const std::size_t visits = count_visits(tile);
        scratch.transmittance.require(16 * visits);
        scratch.tags.require(visits);
        kernels.render_backward(tile, gradient, {scratch.transmittance.data(), scratch.tags.data()},
                                scratch.slots.data(), sums.data());
    });
    team.run(tasks_of(cloud.count), [&](int task, int) {
        const std::size_t end = std::min(cloud.count, (task + 1) * kPointsPerTask);
        for (std::size_t point = task * kPointsPerTask; point < end; ++point) {
            gather_gradient(cloud, settings, bins, slots, sums.data(), point, out);
        }
    });
}

void visibility(const Cloud& cloud, const Settings& settings, float* out) {
    const TileKernels& kernels = tile_kernels(settings.simd);
    Team team(settings.threads);
    const Bins bins = bin_points(cloud, settings, team);
    const Slots slots = assign_slots(cloud, bins);
    Buffer<float> weights(bins.entries.size());
    std::vector<Scratch> scratches(team.size());
    team.run(bins.tiles(), [&](int index, int worker) {
        const Tile tile = tile_at(cloud, settings, bins, index);
        Scratch& scratch = scratches[worker];
        slots_of_tile(tile, bins, slots, scratch.slots);
        for (std::size_t entry = 0; entry < tile.count; ++entry) weights[scratch.slots[entry]] = 0.0f;
        kernels.visibility(tile, scratch.slots.data(), weights.data());
    });
    for (std::size_t point = 0; point < cloud.count; ++point) {
        float best = 0.0f;
        for (std::size_t slot = slots.begin[point]; slot < slots.begin[point + 1]; ++slot) best = std::max(best, weights[slot]);
        out[point] = best;
    }
}

}  // namespace fourd::points
