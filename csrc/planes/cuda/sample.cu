#include "planes/cuda/sample.h"

#include "device/clear.h"
#include "device/machine.h"

namespace fourd::planes::cuda {
namespace {

// Kernels over a query's points and planes, plane by plane within a point, so that threads side by side write
// side by side.
struct Table {
    Plane planes[kMostPlanes];
    int plane_count, features;
    const float* coordinates;

    explicit Table(const Query& query)
        : plane_count(query.plane_count), features(query.features), coordinates(query.coordinates) {
        for (int k = 0; k < plane_count; ++k) planes[k] = query.planes[k];
    }
};

struct Place {
    std::size_t point;
    int plane;
    Between x, y;
    Corners corners;

    FOURD_DEVICE Place(const Table& table, std::size_t index) {
        point = index / table.plane_count;
        plane = static_cast<int>(index % table.plane_count);
        const Plane& of = table.planes[plane];
        x = between(table.coordinates[4 * point + of.across], of.columns);
        y = between(table.coordinates[4 * point + of.down], of.rows);
        corners = planes::corners(of, x, y, table.features);
    }
};

struct Sample {
    Table table;
    float* out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place place(table, index);
        const Corners& at = place.corners;
        const int features = table.features;
        const float* top = table.planes[place.plane].values + at.top;
        const float* bottom = table.planes[place.plane].values + at.bottom;
        float* to = out + index * features;
        for (int f = 0; f < features; ++f) {
            to[f] = at.weight[0][0] * top[f] + at.weight[0][1] * top[features + f] + at.weight[1][0] * bottom[f] +
                    at.weight[1][1] * bottom[features + f];
        }
    }
};

struct SampleBackward {
    Table table;
    const float* gradient;
    float* to_planes[kMostPlanes];
    float* to_coordinates;  // or null

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place place(table, index);
        const Corners& at = place.corners;
        const Plane& plane = table.planes[place.plane];
        const int features = table.features;
        const float *top = plane.values + at.top, *bottom = plane.values + at.bottom;
        float *to_top = to_planes[place.plane] + at.top, *to_bottom = to_planes[place.plane] + at.bottom;
        float across = 0.0f, down = 0.0f;
        for (int f = 0; f < features; ++f) {
            const float g = gradient[index * features + f];
            device::add_shared(to_top + f, at.weight[0][0] * g);
            device::add_shared(to_top + features + f, at.weight[0][1] * g);
            device::add_shared(to_bottom + f, at.weight[1][0] * g);
            device::add_shared(to_bottom + features + f, at.weight[1][1] * g);
            const float upper = top[features + f] - top[f], lower = bottom[features + f] - bottom[f];
            across += g * (upper + place.y.share * (lower - upper));
            const float left = bottom[f] - top[f], right = bottom[features + f] - top[features + f];
            down += g * (left + place.x.share * (right - left));
        }
        if (!to_coordinates) return;
        device::add_shared(to_coordinates + 4 * place.point + plane.across, across * place.x.slope);
        device::add_shared(to_coordinates + 4 * place.point + plane.down, down * place.y.slope);
    }
};

}  // namespace

void sample(const Query& query, float* out, void* stream) {
    device::Machine(stream).each(query.count * query.plane_count, Sample{Table(query), out});
}

void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates,
                     void* stream) {
    const device::Machine machine(stream);
    SampleBackward kernel{Table(query), gradient, {}, grad_coordinates};
    for (int k = 0; k < query.plane_count; ++k) {
        const Plane& plane = query.planes[k];
        const std::size_t size = static_cast<std::size_t>(plane.rows) * plane.columns * query.features;
        machine.each(size, device::Clear{grad_planes[k]});
        kernel.to_planes[k] = grad_planes[k];
    }
    if (grad_coordinates) machine.each(4 * query.count, device::Clear{grad_coordinates});
    machine.each(query.count * query.plane_count, kernel);
}

}  // namespace fourd::planes::cuda
