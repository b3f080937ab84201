#include "planes/cuda/sample.h"

#include "device/clear.h"
#include "device/executor.h"

namespace fourd::planes::cuda {
namespace {

// The planes and points that a kernel processes. Consecutive threads process different planes of the same point, so
// that adjacent threads write adjacent memory.
struct PlaneTable {
    Plane planes[kMaxPlanes];
    int plane_count, features;
    const float* coordinates;

    explicit PlaneTable(const Query& query)
        : plane_count(query.plane_count), features(query.features), coordinates(query.coordinates) {
        for (int k = 0; k < plane_count; ++k) planes[k] = query.planes[k];
    }
};

struct Location {
    std::size_t point;
    int plane;
    Interpolation x, y;
    Corners corners;

    FOURD_DEVICE Location(const PlaneTable& table, std::size_t index) {
        point = index / table.plane_count;
        plane = static_cast<int>(index % table.plane_count);
        const Plane& of = table.planes[plane];
        x = interpolate_axis(table.coordinates[4 * point + of.x_axis], of.columns);
        y = interpolate_axis(table.coordinates[4 * point + of.y_axis], of.rows);
        corners = planes::corners(of, x, y, table.features);
    }
};

struct Sample {
    PlaneTable table;
    float* out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Location location(table, index);
        const Corners& at = location.corners;
        const int features = table.features;
        const float* top = table.planes[location.plane].values + at.top;
        const float* bottom = table.planes[location.plane].values + at.bottom;
        float* to = out + index * features;
        for (int f = 0; f < features; ++f) {
            to[f] = at.weight[0][0] * top[f] + at.weight[0][1] * top[features + f] + at.weight[1][0] * bottom[f] +
                    at.weight[1][1] * bottom[features + f];
        }
    }
};

struct SampleBackward {
    PlaneTable table;
    const float* gradient;
    float* to_planes[kMaxPlanes];
    float* to_coordinates;  // Null if the gradient of the coordinates is not needed.

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Location location(table, index);
        const Corners& at = location.corners;
        const Plane& plane = table.planes[location.plane];
        const int features = table.features;
        const float *top = plane.values + at.top, *bottom = plane.values + at.bottom;
        float *to_top = to_planes[location.plane] + at.top, *to_bottom = to_planes[location.plane] + at.bottom;
        float across = 0.0f, down = 0.0f;
        for (int f = 0; f < features; ++f) {
            const float g = gradient[index * features + f];
            device::atomic_add(to_top + f, at.weight[0][0] * g);
            device::atomic_add(to_top + features + f, at.weight[0][1] * g);
            device::atomic_add(to_bottom + f, at.weight[1][0] * g);
            device::atomic_add(to_bottom + features + f, at.weight[1][1] * g);
            const float upper = top[features + f] - top[f], lower = bottom[features + f] - bottom[f];
            across += g * (upper + location.y.fraction * (lower - upper));
            const float left = bottom[f] - top[f], right = bottom[features + f] - top[features + f];
            down += g * (left + location.x.fraction * (right - left));
        }
        if (!to_coordinates) return;
        device::atomic_add(to_coordinates + 4 * location.point + plane.x_axis, across * location.x.slope);
        device::atomic_add(to_coordinates + 4 * location.point + plane.y_axis, down * location.y.slope);
    }
};

}  // namespace

void sample(const Query& query, float* out, void* stream) {
    device::Executor(stream).for_each(query.count * query.plane_count, Sample{PlaneTable(query), out});
}

void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates,
                     void* stream) {
    const device::Executor executor(stream);
    SampleBackward kernel{PlaneTable(query), gradient, {}, grad_coordinates};
    for (int k = 0; k < query.plane_count; ++k) {
        const Plane& plane = query.planes[k];
        const std::size_t size = static_cast<std::size_t>(plane.rows) * plane.columns * query.features;
        executor.for_each(size, device::Clear{grad_planes[k]});
        kernel.to_planes[k] = grad_planes[k];
    }
    if (grad_coordinates) executor.for_each(4 * query.count, device::Clear{grad_coordinates});
    executor.for_each(query.count * query.plane_count, kernel);
}

}  // namespace fourd::planes::cuda
