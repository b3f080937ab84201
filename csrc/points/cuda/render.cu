#include "points/cuda/render.h"

#include "device/clear.h"
#include "points/cuda/gradient.h"

namespace fourd::points::cuda {
namespace {

View view_of(const Entries& entries, const Settings& settings) {
    return {entries, settings.camera.width, settings.camera.height, settings.layers, settings.transmittance_min};
}

std::size_t pixels(const Entries& entries) { return entries.tiles.count() * kTilePixels; }

int sums_of(int channels) { return 5 + channels; }

template <int kCapacity>
void gradient_pixels(const device::Executor& executor, const View& view, const Cloud& cloud,
                     const ImageGradient& gradient) {
    const std::size_t count = pixels(view.entries);
    if (view.layers <= 16) {
        executor.for_each_in_warps(count, GradientPixel<kCapacity, 16>{view, cloud.features, cloud.channels, gradient});
    } else {
        executor.for_each_in_warps(
            count, GradientPixel<kCapacity, kMaxLayersBackward>{view, cloud.features, cloud.channels, gradient});
    }
}

}  // namespace

std::size_t workspace_bytes(std::size_t count, int channels, int width, int height, std::size_t entries) {
    device::Arena arena(nullptr);
    allocate_entries(arena, count, sums_of(channels), tiles_of(width, height), entries);
    return arena.bytes();
}

void render(const Cloud& cloud, const Settings& settings, const EntryBuffer& room, const Image& out, void* stream) {
    const device::Executor executor(stream);
    const View view = view_of(fill(executor, cloud, settings, room, sums_of(cloud.channels)), settings);
    const std::size_t count = pixels(view.entries);
    if (cloud.channels <= 4) {
        executor.for_each_in_warps(count, RenderPixel<4>{view, cloud.features, cloud.channels, out});
    } else if (cloud.channels <= 8) {
        executor.for_each_in_warps(count, RenderPixel<8>{view, cloud.features, cloud.channels, out});
    } else {
        executor.for_each_in_warps(count, RenderPixel<32>{view, cloud.features, cloud.channels, out});
    }
}

void draw(const Cloud& cloud, const Settings& settings, const EntryBuffer& room, const Canvas& out, void* stream) {
    const device::Executor executor(stream);
    const View view = view_of(fill(executor, cloud, settings, room, sums_of(cloud.channels)), settings);
    executor.for_each_in_warps(pixels(view.entries), DrawPixel{view, cloud.features, out});
}

void render_backward(const Cloud& cloud, const Settings& settings, const EntryBuffer& room,
                     const ImageGradient& gradient, const CloudGradient& out, void* stream) {
    const device::Executor executor(stream);
    const Entries entries = fill(executor, cloud, settings, room, sums_of(cloud.channels));
    executor.for_each(cloud.count * static_cast<std::size_t>(sums_of(cloud.channels)), device::Clear{entries.sums});
    const View view = view_of(entries, settings);
    if (cloud.channels <= 4) {
        gradient_pixels<4>(executor, view, cloud, gradient);
    } else if (cloud.channels <= 8) {
        gradient_pixels<8>(executor, view, cloud, gradient);
    } else {
        gradient_pixels<32>(executor, view, cloud, gradient);
    }
    executor.for_each(cloud.count, GradientPoint{entries, settings.camera, cloud.density, cloud.channels, out});
}

void visibility(const Cloud& cloud, const Settings& settings, const EntryBuffer& room, float* out, void* stream) {
    const device::Executor executor(stream);
    const Entries entries = fill(executor, cloud, settings, room, sums_of(cloud.channels));
    executor.for_each(cloud.count, device::Clear{out});
    executor.for_each_in_warps(pixels(entries), VisibilityPixel{view_of(entries, settings), out});
}

}  // namespace fourd::points::cuda
