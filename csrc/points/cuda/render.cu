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

template <int kRoom>
void gradient_pixels(const device::Machine& machine, const View& view, const Cloud& cloud,
                     const ImageGradient& gradient) {
    const std::size_t count = pixels(view.entries);
    if (view.layers <= 16) {
        machine.warps(count, GradientPixel<kRoom, 16>{view, cloud.features, cloud.channels, gradient});
    } else {
        machine.warps(count, GradientPixel<kRoom, kMostLayersBackward>{view, cloud.features, cloud.channels, gradient});
    }
}

}  // namespace

std::size_t workspace_bytes(std::size_t count, int channels, int width, int height, std::size_t entries) {
    device::Arena arena(nullptr);
    lay_out(arena, count, sums_of(channels), tiles_of(width, height), entries);
    return arena.bytes();
}

void render(const Cloud& cloud, const Settings& settings, const Room& room, const Image& out, void* stream) {
    const device::Machine machine(stream);
    const View view = view_of(fill(machine, cloud, settings, room, sums_of(cloud.channels)), settings);
    const std::size_t count = pixels(view.entries);
    if (cloud.channels <= 4) {
        machine.warps(count, RenderPixel<4>{view, cloud.features, cloud.channels, out});
    } else if (cloud.channels <= 8) {
        machine.warps(count, RenderPixel<8>{view, cloud.features, cloud.channels, out});
    } else {
        machine.warps(count, RenderPixel<32>{view, cloud.features, cloud.channels, out});
    }
}

void draw(const Cloud& cloud, const Settings& settings, const Room& room, const Canvas& out, void* stream) {
    const device::Machine machine(stream);
    const View view = view_of(fill(machine, cloud, settings, room, sums_of(cloud.channels)), settings);
    machine.warps(pixels(view.entries), DrawPixel{view, cloud.features, out});
}

void render_backward(const Cloud& cloud, const Settings& settings, const Room& room, const ImageGradient& gradient,
                     const CloudGradient& out, void* stream) {
    const device::Machine machine(stream);
    const Entries entries = fill(machine, cloud, settings, room, sums_of(cloud.channels));
    machine.each(cloud.count * static_cast<std::size_t>(sums_of(cloud.channels)), device::Clear{entries.sums});
    const View view = view_of(entries, settings);
    if (cloud.channels <= 4) {
        gradient_pixels<4>(machine, view, cloud, gradient);
    } else if (cloud.channels <= 8) {
        gradient_pixels<8>(machine, view, cloud, gradient);
    } else {
        gradient_pixels<32>(machine, view, cloud, gradient);
    }
    machine.each(cloud.count, GradientPoint{entries, settings.camera, cloud.density, cloud.channels, out});
}

void visibility(const Cloud& cloud, const Settings& settings, const Room& room, float* out, void* stream) {
    const device::Machine machine(stream);
    const Entries entries = fill(machine, cloud, settings, room, sums_of(cloud.channels));
    machine.each(cloud.count, device::Clear{out});
    machine.warps(pixels(entries), SeePixel{view_of(entries, settings), out});
}

}  // namespace fourd::points::cuda
