#include <algorithm>
#include <cstring>

#include "points/cpu/workspace.h"

namespace fourd::points {
namespace {

constexpr std::size_t kPointsPerTask = 4096;

Fingerprint fingerprint(const Cloud& cloud, const Settings& settings) {
    Fingerprint out;
    out.add(&settings.camera, sizeof settings.camera);
    out.add(&settings.near_depth, sizeof settings.near_depth);
    out.add(&cloud.count, sizeof cloud.count);
    out.add(cloud.xyz, 3 * cloud.count * sizeof(float));
    out.add(cloud.features, cloud.channels * cloud.count * sizeof(float));
    out.add(cloud.radius, cloud.count * sizeof(float));
    out.add(cloud.density, cloud.count * sizeof(float));
    return out;
}

// Computes the gradient of a point. For each tile that the point covers, one slot (tiles/depth_bins.h) has the sums of
// gradients over the pixels of the tile. The function adds these slots in order, and computes the gradient from the
// total. The template argument Channels is the number of channels if it is known at compile time, and 0 otherwise.
template <int Channels>
void gather_gradient(const Cloud& cloud, const Settings& settings, const Workspace& workspace, std::size_t point,
                     const CloudGradient& out) {
    const std::size_t channels = static_cast<std::size_t>(Channels > 0 ? Channels : cloud.channels);
    const std::size_t width = 5 + channels;
    float total[5 + (Channels > 0 ? Channels : 32)] = {};
    for (std::size_t slot = workspace.slots.begin(point); slot < workspace.slots.end(point); ++slot) {
        for (std::size_t k = 0; k < width; ++k) total[k] += workspace.sums[slot * width + k];
    }
    for (std::size_t c = 0; c < channels; ++c) out.features[point * channels + c] = total[5 + c];
    if (workspace.slots.begin(point) == workspace.slots.end(point)) {
        std::fill_n(out.xyz + 3 * point, 3, 0.0f);
        out.radius[point] = out.density[point] = 0.0f;
        return;
    }
    const SplatGradient gradient = {total[0], total[1], total[2], total[3], total[4]};
    project_backward(settings.camera, workspace.bins.splats()[point], gradient, cloud.density[point],
                     out.xyz + 3 * point, out.radius + point, out.density + point);
}

}  // namespace

void Workspace::fill(const Cloud& cloud, const Settings& settings, Team& team) {
    source_fingerprint = Fingerprint();
    bins.fill(cloud, settings, team);
}

void Workspace::fill_unless_current(const Cloud& cloud, const Settings& settings, Team& team) {
    if (fingerprint(cloud, settings) == source_fingerprint) return;
    fill(cloud, settings, team);
}

std::size_t Workspace::bytes() const {
    std::size_t total = bins.bytes() + sizeof(float) * sums.size() + slots.bytes();
    for (const Scratch& scratch : scratch_by_worker) {
        total += sizeof(std::size_t) * scratch.slots.size() + sizeof(float) * scratch.transmittance.size() +
                 sizeof(std::uint64_t) * scratch.tags.size();
    }
    return total;
}

Tile Workspace::tile(const Cloud& cloud, const Settings& settings, int index) const {
    Tile out;
    out.splats = bins.splats();
    out.features = cloud.features;
    out.entries = bins.entries() + bins.tile_begin()[index];
    out.count = bins.tile_begin()[index + 1] - bins.tile_begin()[index];
    out.channels = cloud.channels;
    out.layers = settings.layers;
    out.transmittance_min = settings.transmittance_min;
    out.column = index % bins.columns() * kTile;
    out.row = index / bins.columns() * kTile;
    out.width = settings.camera.width;
    out.height = settings.camera.height;
    return out;
}

std::size_t count_visits(const Tile& tile) {
    std::size_t visits = 0;
    for (std::size_t entry = 0; entry < tile.count; ++entry) {
        const Splat& splat = tile.splats[tile.entries[entry]];
        const int column = tile.column / kBlock, row = tile.row / kBlock;
        const int left = std::max(splat.left - column, 0), right = std::min(splat.right - column, kBlock - 1);
        const int top = std::max(splat.top - row, 0), bottom = std::min(splat.bottom - row, kBlock - 1);
        visits += static_cast<std::size_t>(right - left + 1) * (bottom - top + 1);
    }
    return visits;
}

void render(const Cloud& cloud, const Settings& settings, Workspace& workspace, const Image& out) {
    const Loops& loops = select_loops(settings.simd);
    Team team(settings.threads);
    workspace.source_fingerprint = Fingerprint();
    workspace.bins.prepare(cloud, settings, team);
    const bool is_complete = workspace.draw_tiles(
        team, [&](int index) { loops.render(workspace.tile(cloud, settings, index), out); });
    if (is_complete) workspace.source_fingerprint = fingerprint(cloud, settings);
}

void render_backward(const Cloud& cloud, const Settings& settings, Workspace& workspace, const ImageGradient& gradient,
                     const CloudGradient& out) {
    const Loops& loops = select_loops(settings.simd);
    Team team(settings.threads);
    workspace.fill_unless_current(cloud, settings, team);
    const std::size_t width = 5 + cloud.channels;
    workspace.sums.require(workspace.slots.assign(workspace.bins, cloud.count) * width);
    workspace.scratch_by_worker.resize(team.size());
    tiles::run_tiles(team, 0, workspace.bins.tiles(), [&](int index, int worker) {
        const Tile tile = workspace.tile(cloud, settings, index);
        Workspace::Scratch& scratch = workspace.scratch_by_worker[worker];
        workspace.slots.of_tile(workspace.bins, index, scratch.slots);
        const std::size_t visits = count_visits(tile);
        scratch.transmittance.require(16 * visits);
        scratch.tags.require(visits);
        loops.render_backward(tile, gradient, {scratch.transmittance.data(), scratch.tags.data(), visits},
                              scratch.slots.data(), workspace.sums.data());
    });
    run_parts(team, cloud.count, kPointsPerTask, [&](std::size_t begin, std::size_t end) {
        const auto gather = cloud.channels == 3   ? gather_gradient<3>
                            : cloud.channels == 4 ? gather_gradient<4>
                                                  : gather_gradient<0>;
        for (std::size_t point = begin; point < end; ++point) gather(cloud, settings, workspace, point, out);
    });
}

void visibility(const Cloud& cloud, const Settings& settings, Workspace& workspace, float* out) {
    const Loops& loops = select_loops(settings.simd);
    Team team(settings.threads);
    workspace.fill(cloud, settings, team);
    workspace.sums.require(workspace.slots.assign(workspace.bins, cloud.count));
    workspace.scratch_by_worker.resize(team.size());
    tiles::run_tiles(team, 0, workspace.bins.tiles(), [&](int index, int worker) {
        const Tile tile = workspace.tile(cloud, settings, index);
        Workspace::Scratch& scratch = workspace.scratch_by_worker[worker];
        workspace.slots.of_tile(workspace.bins, index, scratch.slots);
        for (std::size_t entry = 0; entry < tile.count; ++entry) workspace.sums[scratch.slots[entry]] = 0.0f;
        loops.visibility(tile, scratch.slots.data(), workspace.sums.data());
    });
    for (std::size_t point = 0; point < cloud.count; ++point) {
        float best = 0.0f;
        for (std::size_t slot = workspace.slots.begin(point); slot < workspace.slots.end(point); ++slot) {
            best = std::max(best, workspace.sums[slot]);
        }
        out[point] = best;
    }
}

}  // namespace fourd::points
