#include <algorithm>
#include <cstring>

#include "soft_triangles/cpu/workspace.h"
#include "tiles/corner_sums.h"
#include "tiles/run_tiles.h"

namespace fourd::soft_triangles {
namespace {

constexpr std::size_t kTrianglesPerTask = 4096;

// Computes the gradients of a triangle's corners and features. For each tile that the triangle covers, one slot
// (tiles/depth_bins.h) has the sums of gradients over the pixels of the tile. The function adds these slots in a fixed
// order, and computes the gradients from the total.
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
        return;
    }
    ShapeGradient sums;
    std::memcpy(&sums, total, sizeof sums);
    static_assert(sizeof sums == kShapeSums * sizeof(float), "the sums have the order of ShapeGradient");
    project_backward(settings.camera, corners_of(settings.camera, mesh.xyz, mesh.tri + 3 * triangle), sums, corners);
}

}  // namespace

Visits Workspace::Scratch::visits(const Tile& tile) {
    blocks.require(tile.count);
    entries.require(tile.count);
    x.require(16 * tile.count);
    depth.require(16 * tile.count);
    return {blocks.data(), entries.data(), x.data(), depth.data()};
}

void Workspace::fill(const Mesh& mesh, const Settings& settings, Team& team) {
    faces.require(mesh.count);
    const auto project = [&, project = select_loops(settings.simd).project](
                             std::size_t begin, std::size_t end, TileRange* tile_ranges, Item* items) {
        return project(mesh, settings, begin, end, faces.data(), tile_ranges, items);
    };
    bins.fill(mesh.count, settings.camera.width, settings.camera.height, project, team);
    scratch_by_worker.resize(team.size());
}

Tile Workspace::tile(const Mesh& mesh, const Settings& settings, int index) const {
    Tile out;
    out.faces = faces.data();
    out.features = mesh.features;
    out.entries = bins.entries() + bins.tile_begin()[index];
    out.count = bins.tile_begin()[index + 1] - bins.tile_begin()[index];
    out.softness = settings.softness;
    out.channels = mesh.channels;
    out.layers = settings.layers;
    out.column = index % bins.columns() * kTile;
    out.row = index / bins.columns() * kTile;
    out.width = settings.camera.width;
    out.height = settings.camera.height;
    return out;
}

std::size_t Workspace::bytes() const {
    std::size_t total =
        bins.bytes() + slots.bytes() + sizeof(Face) * faces.size() + sizeof(float) * (sums.size() + corners.size());
    for (const Scratch& scratch : scratch_by_worker) {
        total += sizeof(std::size_t) * scratch.slots.size() + sizeof(float) * (scratch.x.size() + scratch.depth.size()) +
                 sizeof(std::uint16_t) * scratch.blocks.size() + sizeof(std::uint32_t) * scratch.entries.size();
    }
    return total;
}

void render(const Mesh& mesh, const Settings& settings, Workspace& workspace, const Image& out) {
    const Loops& loops = select_loops(settings.simd);
    Team team(settings.threads);
    workspace.fill(mesh, settings, team);
    tiles::run_tiles(team, 0, workspace.bins.tiles(), [&](int index, int worker) {
        const Tile tile = workspace.tile(mesh, settings, index);
        loops.render(tile, workspace.scratch_by_worker[worker].visits(tile), out);
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
    tiles::run_tiles(team, 0, workspace.bins.tiles(), [&](int index, int worker) {
        const Tile tile = workspace.tile(mesh, settings, index);
        Workspace::Scratch& scratch = workspace.scratch_by_worker[worker];
        workspace.slots.of_tile(workspace.bins, index, scratch.slots);
        loops.render_backward(tile, scratch.visits(tile), gradient, scratch.slots.data(), workspace.sums.data());
    });
    run_parts(team, mesh.count, kTrianglesPerTask, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) gather_gradient(mesh, settings, workspace, i, out);
    });
    tiles::add_corners(workspace.corners.data(), mesh.tri, mesh.count, out.xyz, mesh.vertices);
}

}  // namespace fourd::soft_triangles
