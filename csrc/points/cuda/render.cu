#include "points/cuda/render.h"

#include "device/clear.h"
#include "points/cuda/gradient.h"

namespace fourd::points::cuda {
namespace {

View make_view(const Entries& entries, const Settings& settings) {
    return {entries, settings.camera.width, settings.camera.height, settings.layers, settings.transmittance_min};
}

std::size_t pixel_count(const Entries& entries) { return entries.tiles.count() * kTilePixels; }

int sum_count(int channels) { return 5 + channels; }

template <int kCapacity>
void gradient_pixels(const device::Executor& executor, const View& view, const Cloud& cloud,
                     const ImageGradient& gradient) {
    const std::size_t count = pixel_count(view.entries);
    if (view.layers <= 16) {
        executor.for_each_in_warps(count, GradientPixel<kCapacity, 16>{view, cloud.features, cloud.channels, gradient});
    } else {
        executor.for_each_in_warps(
            count, GradientPixel<kCapacity, kMaxLayersBackward>{view, cloud.features, cloud.channels, gradient});
    }
}

}  // namespace

std::size_t workspace_bytes(std::size_t count, int channels, int width, int height, std::size_t entries) {
    return tiles::cuda::entry_bytes<Splat>(count, sum_count(channels), width, height, entries);
}

void render(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, const Image& out, void* stream) {
    const device::Executor executor(stream);
    const View view = make_view(fill(executor, cloud, settings, buffer, sum_count(cloud.channels)), settings);
    const std::size_t count = pixel_count(view.entries);
    if (cloud.channels <= 4) {
        executor.for_each_in_warps(count, RenderPixel<4>{view, cloud.features, cloud.channels, out});
    } else if (cloud.channels <= 8) {
        executor.for_each_in_warps(count, RenderPixel<8>{view, cloud.features, cloud.channels, out});
    } else {
        executor.for_each_in_warps(count, RenderPixel<32>{view, cloud.features, cloud.channels, out});
    }
}

void draw(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, const Canvas& out, void* stream) {
    const device::Executor executor(stream);
    const View view = make_view(fill(executor, cloud, settings, buffer, sum_count(cloud.channels)), settings);
    executor.for_each_in_warps(pixel_count(view.entries), DrawPixel{view, cloud.features, out});
}

void render_backward(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer,
                     const ImageGradient& gradient, const CloudGradient& out, void* stream) {
    const device::Executor executor(stream);
    const Entries entries = fill(executor, cloud, settings, buffer, sum_count(cloud.channels));
    executor.for_each(cloud.count * static_cast<std::size_t>(sum_count(cloud.channels)), device::Clear{entries.sums});
    const View view = make_view(entries, settings);
    if (cloud.channels <= 4) {
        gradient_pixels<4>(executor, view, cloud, gradient);
    } else if (cloud.channels <= 8) {
        gradient_pixels<8>(executor, view, cloud, gradient);
    } else {
        gradient_pixels<32>(executor, view, cloud, gradient);
    }
    executor.for_each(cloud.count, GradientPoint{entries, settings.camera, cloud.density, cloud.channels, out});
}

void visibility(const Cloud& cloud, const Settings& settings, const EntryBuffer& buffer, float* out, void* stream) {
    const device::Executor executor(stream);
    const Entries entries = fill(executor, cloud, settings, buffer, sum_count(cloud.channels));
    executor.for_each(cloud.count, device::Clear{out});
    executor.for_each_in_warps(pixel_count(entries), VisibilityPixel{make_view(entries, settings), out});
}

}  // namespace fourd::points::cuda
