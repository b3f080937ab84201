// The inner loops over runs of points, compiled once for each instruction set.
#pragma once

#include <cstdint>

#include "common/dispatch.h"
#include "planes/planes.h"

namespace fourd::planes {

constexpr int kRun = 64;  // points whose positions stay in the L1 cache

// A coordinate on a number of samples. Planes have axes in common: a point is located once per axis, not once per
// plane.
struct Axis {
    int coordinate;
    int size;
};

// A query with its distinct axes, and its points in spatial order, so that neighbours share cache lines of the planes.
struct Plan {
    const Query* query;
    const Axis* axes;
    int axis_count;
    const int* x_axis;  // by plane: index into axes
    const int* y_axis;
    const int* large;  // planes that exceed a core's caches, ascending
    int large_count;
    const std::uint32_t* order;
};

// The positions of one run's points, by axis.
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
    // Adds to planes first to last (exclusive).
    void (*scatter)(const Plan&, std::size_t begin, int count, const RunPositions&, int first, int last,
                    const float* gradient, float* const* out);
};

struct Loops {
    RunLoops eight_features;  // the usual number, known at compile time
    RunLoops any_features;

    const RunLoops& of(int features) const { return features == 8 ? eight_features : any_features; }
};

// 8 features fill the vectors of AVX2: AVX-512 has no loops of its own.
FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::planes
