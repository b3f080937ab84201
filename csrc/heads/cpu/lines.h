// What time planes contribute to the first layers of the heads, as one table for each axis of space.
//
// A point's features are interpolated from planes, and the first layers are linear, so interpolating the outputs of the
// layers gives the same result. All points have the same time, so the samples of the time planes are few. Multiplying
// them by the weights costs little, and each point adds six rows of the tables instead of multiplying half of its
// features by the weights.
#pragma once

#include <cstddef>
#include <vector>

#include "common/buffer.h"
#include "heads/cpu/loops.h"

namespace fourd::heads {

class TimeTables {
  public:
    TimeTables(const Sizes& sizes, const TimePlanes& planes, const float* const* weights, const Loops& loops);

    // Null without time planes.
    const AxisTable* get() const { return axes_.empty() ? nullptr : tables_; }

    // The number of knots of all axes.
    std::size_t knots() const { return knots_; }

    // Computes the gradients of the planes, and of the weights of their features, from the gradient of the tables
    // (knots(), 3 * hidden). Writes all elements of the planes' gradients.
    void write_gradients(const float* to_tables, float* const* to_planes, float* const* to_weights) const;

  private:
    struct Axis {
        std::vector<int> planes;
        std::vector<float> positions, scales;
        std::vector<int> starts;
        Buffer<float> features;  // Shape (knots, width): the features of all planes at the knots.
        Buffer<float> weights;   // Shape (width, 3 * hidden).
        Buffer<float> values;
        int width = 0;
    };

    void place_knots(Axis& axis) const;
    void sample_planes(Axis& axis) const;
    void pack_weights(Axis& axis, const float* const* weights) const;
    void write_weights(const Axis& axis, const float* to_tables, float* const* out) const;
    void add_to_planes(const Axis& axis, const float* to_tables, float* const* out) const;

    Sizes sizes_;
    TimePlanes planes_;
    const Loops& loops_;
    std::vector<Axis> axes_;
    AxisTable tables_[3] = {};
    std::size_t knots_ = 0;
};

}  // namespace fourd::heads
