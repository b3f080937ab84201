#include <algorithm>
#include <cstring>

#include "splat_triangles/cpu/workspace.h"
#include "tiles/corner_sums.h"
#include "tiles/run_tiles.h"

namespace fourd::splat_triangles {
namespace {

constexpr std::size_t kTrianglesPerTask = 4096;

Fingerprint fingerprint(const Mesh& mesh, const Settings& settings) {
    Fingerprint out;
    out.add(&settings.camera, sizeof settings.camera);
    out.add(&settings.near_depth, sizeof settings.near_depth);
    out.add(&mesh.count, sizeof mesh.count);
    out.add(&mesh.vertices, sizeof mesh.vertices);
    out.add(mesh.xyz, 3 * mesh.vertices * sizeof(float));
    out.add(mesh.tri, 3 * mesh.count * sizeof(std::int32_t));
    out.add(mesh.opacity, mesh.count * sizeof(float));
    out.add(mesh.sigma, mesh.count * sizeof(float));
    return out;
}

// Computes the gradients of a triangle's corners, features, opacity and sigma. For each tile that the triangle covers,
// one slot (tiles/depth_bins.h) has the sums of gradients over the pixels of the tile. The function adds these slots in
// a fixed order, and computes the gradients from the total.
void gather_gradient(const Mesh& mesh, const Settings& settings, Workspace& workspace, std::size_t triangle,
                     const MeshGradient& out) {
    const std::size_t channels = static_cast<std::size_t>(mesh.channels), width = kShapeSums + channels;
    float total[kShapeSums + kMaxChannels] = {};
    for (std::size_t slot = workspace.slots.begin(triangle); slot < workspace.slots.end(triangle); ++slot) {
        for (std::size_t k = 0; k < width; ++k) total[k] += workspace.sums[slot * width + k];
    }
    std::copy_n(total + kShapeSums, channels, out.features + triangle * channels);
    float* corners = workspace.corners.data() + 9 * triangle;
    if (workspace.slots.begin(triangle) == workspace.slots.end(triangle)) {
        std::fill_n(corners, 9, 0.0f);
        out.opacity[triangle] = out.sigma[triangle] = 0.0f;
        return;
    }
    ShapeGradient sums;
    std::memcpy(&sums, total, sizeof sums);
    out.opacity[triangle] = sums.opacity;
    out.sigma[triangle] = sums.sigma;
    const Corners<float> at = corners_of(settings.camera, mesh.xyz, mesh.tri + 3 * triangle);
    project_backward(settings.camera, at, workspace.splats[triangle], sums, corners);
}

}  // namespace

void Workspace::fill(const Mesh& mesh, const Settings& settings, Team& team) {
    const Fingerprint wanted = fingerprint(mesh, settings);
    if (wanted == source_fingerprint) return;
    source_fingerprint = Fingerprint();
    splats.require(mesh.count);
    const auto project = [&, project = select_loops(settings.simd).project](
                             std::size_t begin, std::size_t end, TileRange* tile_ranges, Item* items) {
        return project(mesh, settings, begin, end, splats.data(), tile_ranges, items);
    };
    bins.fill(mesh.count, settings.camera.width, settings.camera.height, project, team);
    source_fingerprint = wanted;
}

Tile Workspace::tile(const Mesh& mesh, const Settings& settings, int index) const {
    Tile out;
    out.splats = splats.data();
    out.features = mesh.features;
    out.entries = bins.entries() + bins.tile_begin()[index];
    out.count = bins.tile_begin()[index + 1] - bins.tile_begin()[index];
    out.channels = mesh.channels;
    out.geometry = mesh.geometry;
    out.layers = settings.layers;
    out.column = index % bins.columns() * kTile;
    out.row = index / bins.columns() * kTile;
    out.width = settings.camera.width;
    out.height = settings.camera.height;
    return out;
}

std::size_t Workspace::bytes() const {
    std::size_t total = bins.bytes() + slots.bytes() + sizeof(Splat) * splats.size() +
                        sizeof(float) * (sums.size() + corners.size());
    for (const Scratch& scratch : scratch_by_worker) {
        total += sizeof(std::size_t) * scratch.slots.size() + sizeof(float) * scratch.best.size();
    }
    return total;
}

void render(const Mesh& mesh, const Settings& settings, Workspace& workspace, const Image& out, float* weight) {
    const Loops& loops = select_loops(settings.simd);
    Team team(settings.threads);
    workspace.fill(mesh, settings, team);
    workspace.sums.require(workspace.slots.assign(workspace.bins, mesh.count));
    workspace.scratch_by_worker.resize(team.size());
    tiles::run_tiles(team, 0, workspace.bins.tiles(), [&](int index, int worker) {
        const Tile tile = workspace.tile(mesh, settings, index);
        Workspace::Scratch& scratch = workspace.scratch_by_worker[worker];
        workspace.slots.of_tile(workspace.bins, index, scratch.slots);
        scratch.best.require(16 * tile.count);
        loops.render(tile, out, scratch.best.data(), scratch.slots.data(), workspace.sums.data());
    });
    run_parts(team, mesh.count, kTrianglesPerTask, [&](std::size_t begin, std::size_t end) {
        for (std::size_t triangle = begin; triangle < end; ++triangle) {
            float best = 0.0f;
            for (std::size_t slot = workspace.slots.begin(triangle); slot < workspace.slots.end(triangle); ++slot) {
                best = std::max(best, workspace.sums[slot]);
            }
            weight[triangle] = best;
        }
    });
}

void render_backward(const Mesh& mesh, const Settings& settings, Workspace& workspace, const ImageGradient& gradient,
                     const MeshGradient& out) {
    const Loops& loops = select_loops(settings.simd);
    Team team(settings.threads);
    workspace.fill(mesh, settings, team);
    const std::size_t width = kShapeSums + static_cast<std::size_t>(mesh.channels);
    workspace.sums.require(workspace.slots.assign(workspace.bins, mesh.count) * width);
    workspace.corners.require(9 * mesh.count);
    workspace.scratch_by_worker.resize(team.size());
    tiles::run_tiles(team, 0, workspace.bins.tiles(), [&](int index, int worker) {
        const Tile tile = workspace.tile(mesh, settings, index);
        Workspace::Scratch& scratch = workspace.scratch_by_worker[worker];
        workspace.slots.of_tile(workspace.bins, index, scratch.slots);
        loops.render_backward(tile, gradient, scratch.slots.data(), workspace.sums.data());
    });
    run_parts(team, mesh.count, kTrianglesPerTask, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) gather_gradient(mesh, settings, workspace, i, out);
    });
    tiles::add_corners(workspace.corners.data(), mesh.tri, mesh.count, out.xyz, mesh.vertices);
}

}  // namespace fourd::splat_triangles
