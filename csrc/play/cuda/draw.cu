#include "play/cuda/draw.h"

#include "common/half.h"
#include "device/arena.h"
#include "device/executor.h"
#include "play/near_fade.h"
#include "shade/cuda/shade.h"

namespace fourd::play::cuda {
namespace {

// Converts radii and densities to float32, and fades the densities of points at the near plane.
struct Unpack {
    Frame frame;
    points::Pinhole camera;
    float near_depth;
    float *radius, *density;

    FOURD_DEVICE void operator()(std::size_t point) const {
        radius[point] = from_half(frame.radius[point]);
        density[point] =
            faded_density(camera, near_depth, frame.points.xyz + 3 * point, from_half(frame.density[point]));
    }
};

// The radii, densities and shaded colours of the points, as float32 arrays at the start of the workspace.
struct Floats {
    float *radius, *density, *colour;

    Floats(device::Arena& arena, std::size_t count)
        : radius(arena.take<float>(count)), density(arena.take<float>(count)), colour(arena.take<float>(3 * count)) {}
};

}  // namespace

std::size_t workspace_bytes(std::size_t count, int width, int height, std::size_t entries) {
    device::Arena arena(nullptr);
    const Floats floats(arena, count);
    return arena.bytes() + points::cuda::workspace_bytes(count, 3, width, height, entries);
}

void draw(const Frame& frame, const points::Settings& settings, const shade::Settings& shading,
          const points::cuda::EntryBuffer& buffer, const points::Canvas& canvas, void* stream) {
    const device::Executor executor(stream);
    const std::size_t count = frame.points.count;
    device::Arena arena(buffer.memory);
    const Floats floats(arena, count);
    executor.for_each(count, Unpack{frame, settings.camera, settings.near_depth, floats.radius, floats.density});
    executor.for_each(count, shade::cuda::ShadePoint(frame.points, shading, floats.colour));
    const points::Cloud cloud{frame.points.xyz, floats.colour, floats.radius, floats.density, count, 3};
    unsigned char* const rest = static_cast<unsigned char*>(buffer.memory) + arena.bytes();
    points::cuda::draw(cloud, settings, {rest, buffer.entries, buffer.needed}, canvas, stream);
}

void shade(const shade::Points& points, const shade::Settings& shading, float* out, void* stream) {
    device::Executor(stream).for_each(points.count, shade::cuda::ShadePoint(points, shading, out));
}

}  // namespace fourd::play::cuda
