// The inner loops over runs of points, compiled once for each instruction set.
#pragma once

#include <cstdint>

#include "common/dispatch.h"
#include "planes/planes.h"

namespace fourd::planes {

constexpr int kRun = 64;   // points whose places between samples stay in the first-level cache

// Planes share sides: a coordinate is placed once among each number of samples, not once a plane.
struct Axis {
    int coordinate;
    int size;
};

// A query with its axes listed, and its points in the order of their place in space, so that neighbours
// in it share cache lines of the planes.
struct Plan {
    const Query* query;
    const Axis* axes;
    int axis_count;
    const int* across;  // by plane: index into axes
    const int* down;
    const int* large;   // planes that do not fit into a core's caches, ascending
    int large_count;
    const std::uint32_t* order;
};

// The places of one run's points, by axis.
struct Places {
    int* low;      // (axis_count, kRun)
    float* share;  // (axis_count, kRun)
    float* slope;  // (axis_count, kRun)

    Between at(int axis, int i) const { return {low[axis * kRun + i], share[axis * kRun + i], slope[axis * kRun + i]}; }
};

struct RunLoops {
    void (*sample)(const Plan&, std::size_t begin, int count, const Places&, float* out);
    void (*coordinate_gradient)(const Plan&, std::size_t begin, int count, const Places&, const float* gradient,
                                float* out);
    // Adds to planes first to last (not included).
    void (*scatter)(const Plan&, std::size_t begin, int count, const Places&, int first, int last,
                    const float* gradient, float* const* out);
};

struct Loops {
    RunLoops eight_features;  // the usual number, known when compiled
    RunLoops any_features;

    const RunLoops& of(int features) const { return features == 8 ? eight_features : any_features; }
};

// 8 features fill the vectors of AVX2: AVX-512 has no loops of its own.
FOURD_DISPATCH(Loops, Simd::avx2)

}  // namespace fourd::planes
