// Shading of baked points (shade/shade.h) on a GPU. All pointers point to GPU memory, except settings.chosen and
// settings.view_weights, which point to host memory.
#pragma once

#include "common/half.h"
#include "shade/maths.h"
#include "shade/shade.h"

namespace fourd::shade::cuda {

// Shades points, one per thread. The kernel object contains a copy of the view indices and view weights, because the
// original arrays are in host memory.
class ShadePoint {
  public:
    ShadePoint(const Points& points, const Settings& settings, float* out)
        : points_(points),
          count_(settings.chosen_count),
          sh_range_(settings.sh_range),
          sh_base_(settings.sh_base),
          out_(out) {
        for (int v = 0; v < count_; ++v) {
            chosen_[v] = settings.chosen[v];
            view_weights_[v] = settings.view_weights[v];
        }
        for (int axis = 0; axis < 3; ++axis) centre_[axis] = settings.centre[axis];
    }

    FOURD_DEVICE void operator()(std::size_t point) const {
        const float* xyz = points_.xyz + 3 * point;
        const std::uint16_t* sh = points_.sh + 3 * kTerms * point;
        float sums[3] = {};
        // The subtraction uses double precision, because a camera may be far from the origin but near the point.
        harmonics(static_cast<float>(xyz[0] - centre_[0]), static_cast<float>(xyz[1] - centre_[1]),
                  static_cast<float>(xyz[2] - centre_[2]), [&](int k, float value) {
                      for (int c = 0; c < 3; ++c) sums[c] += from_half(sh[c * kTerms + k]) * value;
                  });
        float blended[3] = {};
        if (count_ > 0) blend(point, blended);
        for (int c = 0; c < 3; ++c) out_[3 * point + c] = sh_base_ + sh_range_ * fast_tanh(sums[c]) + blended[c];
    }

  private:
    // Blends the colours of the chosen views. The weight of a view is its view weight times its blend weight at the
    // point (Points::weights). If these products are 0 for all chosen views, the weight of a view is its view weight
    // alone. Weights are normalised to the sum 1.
    FOURD_DEVICE void blend(std::size_t point, float* out) const {
        float total = 0.0f, plain_total = 0.0f, plain[3] = {};
        for (int v = 0; v < count_; ++v) {
            const std::size_t at = point * points_.views + static_cast<std::size_t>(chosen_[v]);
            const float weight = view_weights_[v] * from_half(points_.weights[at]);
            total += weight;
            plain_total += view_weights_[v];
            for (int c = 0; c < 3; ++c) {
                out[c] += weight * points_.rgb[3 * at + c];
                plain[c] += view_weights_[v] * points_.rgb[3 * at + c];
            }
        }
        const bool weighted = total > 0.0f;
        const float scale = 1.0f / (255.0f * (weighted ? total : plain_total));
        for (int c = 0; c < 3; ++c) out[c] = scale * (weighted ? out[c] : plain[c]);
    }

    Points points_;
    std::int32_t chosen_[kMaxChosen] = {};
    float view_weights_[kMaxChosen] = {};
    int count_;
    double centre_[3];
    float sh_range_, sh_base_;
    float* out_;
};

}  // namespace fourd::shade::cuda
