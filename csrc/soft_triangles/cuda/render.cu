#include "soft_triangles/cuda/render.h"

#include "device/clear.h"
#include "soft_triangles/cuda/gradient.h"

namespace fourd::soft_triangles::cuda {
namespace {

std::size_t pixel_count(const View& view) { return view.entries.tiles.count() * tiles::cuda::kTilePixels; }

int sum_count(int channels) { return kShapeSums + channels; }

View make_view(const device::Executor& executor, const Mesh& mesh, const Settings& settings,
               const EntryBuffer& buffer) {
    const Entries entries = tiles::cuda::fill<Face>(
        executor, mesh.count, settings.camera.width, settings.camera.height, buffer, sum_count(mesh.channels),
        [&](const Entries& to) { return ProjectTriangle{mesh, settings, to}; });
    return {entries,         settings.softness, settings.camera.width, settings.camera.height,
            settings.layers, mesh.features,     mesh.channels};
}

}  // namespace

std::size_t workspace_bytes(std::size_t count, int channels, int width, int height, std::size_t entries) {
    return tiles::cuda::entry_bytes<Face>(count, sum_count(channels), width, height, entries);
}

void render(const Mesh& mesh, const Settings& settings, const EntryBuffer& buffer, const Image& out, void* stream) {
    const device::Executor executor(stream);
    const View view = make_view(executor, mesh, settings, buffer);
    if (mesh.channels <= 4) {
        executor.for_each(pixel_count(view), RenderPixel<4>{view, out});
    } else {
        executor.for_each(pixel_count(view), RenderPixel<kMaxChannels>{view, out});
    }
}

void render_backward(const Mesh& mesh, const Settings& settings, const EntryBuffer& buffer,
                     const ImageGradient& gradient, const MeshGradient& out, void* stream) {
    const device::Executor executor(stream);
    const View view = make_view(executor, mesh, settings, buffer);
    executor.for_each(mesh.count * static_cast<std::size_t>(sum_count(mesh.channels)),
                      device::Clear{view.entries.sums});
    executor.for_each(3 * mesh.vertices, device::Clear{out.xyz});
    if (mesh.channels <= 4) {
        executor.for_each_in_warps(pixel_count(view), GradientPixel<4>{view, gradient});
    } else {
        executor.for_each_in_warps(pixel_count(view), GradientPixel<kMaxChannels>{view, gradient});
    }
    executor.for_each(mesh.count, GradientTriangle{view.entries, mesh, settings.camera, out});
}

}  // namespace fourd::soft_triangles::cuda
