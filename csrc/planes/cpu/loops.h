// Inner loops over batches of points, compiled once for each instruction set.
#pragma once

#include <cstdint>

#include "common/dispatch.h"
#include "planes/planes.h"

namespace fourd::planes {

constexpr int kRun = 64;  // points per batch; their positions stay in the L1 cache

// A coordinate along which planes have `size` samples. Several planes can share an axis, so a point is located once per
// axis and not once per plane.
struct Axis {
    int coordinate;
    int size;
};

// A query, its distinct axes, and its points in spatial order. In this order, consecutive points share cache lines of
// the planes.
struct Plan {
    const Query* query;
    const Axis* axes;
    int axis_count;
    const int* x_axis;  // for each plane, its index into axes
    const int* y_axis;
    const int* large;  // indices of planes larger than the caches of a core, ascending
    int large_count;
    const std::uint32_t* order;
};

// The positions of the points of a batch, by axis.
struct RunPositions {
    int* low;         // (axis_count, kRun)
    float* fraction;  // (axis_count, kRun)
    float* slope;     // (axis_count, kRun)

    Interpolation at(int axis, int i) const {
        return {low[axis * kRun + i], fraction[axis * kRun + i], slope[axis * kRun + i]};
    }
};

struct RunLoops {
    void (*sample)(const Plan&, std::size_t begin, int count, const RunPositions&, float* out);
    void (*coordinate_gradient)(const Plan&, std::size_t begin, int count, const RunPositions&, const float* gradient,
                                float* out);
    // Adds the batch's contribution to the gradients of planes [first, last), which are in out.
    void (*scatter)(const Plan&, std::size_t begin, int count, const RunPositions&, int first, int last,
                    const float* gradient, float* const* out);
};

struct Loops {
    RunLoops eight_features;  // for the usual 8 features, known at compile time
    RunLoops any_features;

    const RunLoops& of(int features) const { return features == 8 ? eight_features : any_features; }
};

// 8 features fill one AVX2 vector, so there are no loops for AVX-512.
FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::planes
