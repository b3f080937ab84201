// Inner loops over batches of points, compiled once for each instruction set.
#pragma once

#include <cstdint>

#include "common/dispatch.h"
#include "planes/planes.h"

namespace fourd::planes {

constexpr int kRun = 64;  // Number of points per batch. The positions of a batch stay in the L1 cache.

// An axis of a plane: the index (0 to 3) of its coordinate, and the number of samples along it. Each plane has two
// axes. If axes of several planes have the same coordinate and the same number of samples, they are stored as one axis,
// so that the sample indices of a point are computed only once for all these planes.
struct Axis {
    int coordinate;
    int size;
};

// A query, its distinct axes, and the spatial order of its points. In spatial order, consecutive points share cache
// lines of the planes.
struct Plan {
    const Query* query;
    const Axis* axes;
    int axis_count;
    const int* x_axis;  // For each plane, the index of its x axis in `axes`.
    const int* y_axis;
    const int* large;  // Indices, in ascending order, of planes that are larger than the caches of a core.
    int large_count;
    const std::uint32_t* order;  // Shape (query->count,): indices of the points in spatial order.
};

// The members of the struct Interpolation for all points of a batch, as arrays indexed by axis, then by point.
struct RunPositions {
    int* low;         // Shape (axis_count, kRun).
    float* fraction;  // Shape (axis_count, kRun).
    float* slope;     // Shape (axis_count, kRun).

    Interpolation at(int axis, int i) const {
        return {low[axis * kRun + i], fraction[axis * kRun + i], slope[axis * kRun + i]};
    }
};

struct RunLoops {
    void (*sample)(const Plan&, std::size_t begin, int count, const RunPositions&, float* out);
    void (*coordinate_gradient)(const Plan&, std::size_t begin, int count, const RunPositions&, const float* gradient,
                                float* out);
    // Adds the contribution of a batch to the gradients of the planes [first, last). out[k] is the gradient of plane k.
    void (*scatter)(const Plan&, std::size_t begin, int count, const RunPositions&, int first, int last,
                    const float* gradient, float* const* out);
};

struct Loops {
    RunLoops eight_features;  // Loops for 8 features, the usual number.
    RunLoops any_features;

    const RunLoops& of(int features) const { return features == 8 ? eight_features : any_features; }
};

// The loops are not compiled for AVX-512, because the usual 8 features fill exactly one AVX2 vector.
FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::planes
