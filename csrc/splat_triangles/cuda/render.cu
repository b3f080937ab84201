#include "splat_triangles/cuda/render.h"

#include "device/clear.h"
#include "splat_triangles/cuda/gradient.h"

namespace fourd::splat_triangles::cuda {
namespace {

std::size_t pixel_count(const Entries& entries) { return entries.tiles.count() * tiles::cuda::kTilePixels; }

int sum_count(int channels) { return kShapeSums + channels; }

Entries fill(const device::Executor& executor, const Mesh& mesh, const Settings& settings, const EntryBuffer& buffer) {
    return tiles::cuda::fill<Splat>(
        executor, mesh.count, settings.camera.width, settings.camera.height, buffer, sum_count(mesh.channels),
        [&](const Entries& to) { return ProjectTriangle{mesh, settings.camera, settings.near_depth, to}; });
}

View make_view(const Mesh& mesh, const Entries& entries, const Settings& settings) {
    const int features = mesh.channels - (mesh.geometry ? kGeometry : 0);
    return {entries,  settings.camera.width, settings.camera.height, settings.layers, mesh.features,
            mesh.channels, features, mesh.geometry};
}

}  // namespace

std::size_t workspace_bytes(std::size_t count, int channels, int width, int height, std::size_t entries) {
    return tiles::cuda::entry_bytes<Splat>(count, sum_count(channels), width, height, entries);
}

void render(const Mesh& mesh, const Settings& settings, const EntryBuffer& buffer, const Image& out, float* weight,
            void* stream) {
    const device::Executor executor(stream);
    const View view = make_view(mesh, fill(executor, mesh, settings, buffer), settings);
    executor.for_each(mesh.count, device::Clear{weight});
    const std::size_t count = pixel_count(view.entries);
    if (mesh.channels <= 8) {
        executor.for_each_in_warps(count, RenderPixel<8>{view, out, weight});
    } else {
        executor.for_each_in_warps(count, RenderPixel<kMaxChannels>{view, out, weight});
    }
}

void render_backward(const Mesh& mesh, const Settings& settings, const EntryBuffer& buffer,
                     const ImageGradient& gradient, const MeshGradient& out, void* stream) {
    const device::Executor executor(stream);
    const View view = make_view(mesh, fill(executor, mesh, settings, buffer), settings);
    executor.for_each(mesh.count * static_cast<std::size_t>(sum_count(mesh.channels)),
                      device::Clear{view.entries.sums});
    executor.for_each(3 * mesh.vertices, device::Clear{out.xyz});
    const std::size_t count = pixel_count(view.entries);
    if (mesh.channels <= 8) {
        executor.for_each_in_warps(count, GradientPixel<8>{view, gradient});
    } else {
        executor.for_each_in_warps(count, GradientPixel<kMaxChannels>{view, gradient});
    }
    executor.for_each(mesh.count, GradientTriangle{view.entries, mesh, settings.camera, out});
}

}  // namespace fourd::splat_triangles::cuda
