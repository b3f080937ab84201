#include "encoder/cpu/weights.h"

#include <algorithm>
#include <utility>

namespace fourd::encoder {

TapList::TapList(int channels, std::vector<std::ptrdiff_t> offsets)
    : channels_(padded(channels)), offsets_(std::move(offsets)), weights_(channels_ * offsets_.size()) {
    std::fill_n(weights_.data(), weights_.size(), 0.0f);
}

std::vector<std::ptrdiff_t> tap_offsets(const Shape& shape, const Level& level, int stride) {
    const std::ptrdiff_t plane = level.plane(), pitch = level.pitch();
    std::vector<std::ptrdiff_t> out;
    for (int i = 0; i < shape.inputs; ++i) {
        for (int y = 0; y < shape.side; ++y) {
            for (int x = 0; x < shape.side; ++x) {
                if (stride == 1) {
                    out.push_back(i * plane + (y - shape.side / 2) * pitch + x - shape.side / 2);
                } else {
                    const int phase = 2 * (y != 1) + (x != 1);
                    out.push_back((phase * shape.inputs + i) * plane - (y == 0 ? pitch : 0) - (x == 0 ? 1 : 0));
                }
            }
        }
    }
    return out;
}

TapList forward_taps(const Layer& layer, const Level& level, int stride) {
    const Shape& shape = layer.shape;
    TapList out(shape.outputs, tap_offsets(shape, level, stride));
    std::size_t tap = 0;
    for (int i = 0; i < shape.inputs; ++i) {
        for (int y = 0; y < shape.side; ++y) {
            for (int x = 0; x < shape.side; ++x, ++tap) {
                for (int o = 0; o < shape.outputs; ++o) out.weight(tap, o) = layer.weight(o, i, y, x);
            }
        }
    }
    return out;
}

namespace {

// A row or column of a kernel, and the distance from the input to the output that it connects, in rows or columns.
struct Step {
    int index, distance;
};

TapList reversed_taps(const Layer& layer, const Level& level, const std::vector<Step>& rows,
                      const std::vector<Step>& columns) {
    const std::ptrdiff_t plane = level.plane(), pitch = level.pitch();
    std::vector<std::ptrdiff_t> offsets;
    for (int o = 0; o < layer.shape.outputs; ++o) {
        for (const Step& row : rows) {
            for (const Step& column : columns) {
                offsets.push_back(o * plane + row.distance * pitch + column.distance);
            }
        }
    }
    TapList out(layer.shape.inputs, std::move(offsets));
    std::size_t tap = 0;
    for (int o = 0; o < layer.shape.outputs; ++o) {
        for (const Step& row : rows) {
            for (const Step& column : columns) {
                for (int i = 0; i < layer.shape.inputs; ++i) {
                    out.weight(tap, i) = layer.weight(o, i, row.index, column.index);
                }
                ++tap;
            }
        }
    }
    return out;
}

}  // namespace

TapList backward_taps(const Layer& layer, const Level& level) {
    std::vector<Step> steps;
    for (int k = 0; k < layer.shape.side; ++k) steps.push_back({k, layer.shape.side / 2 - k});
    return reversed_taps(layer, level, steps, steps);
}

TapList backward_phase_taps(const Layer& layer, const Level& level, bool odd_row, bool odd_column) {
    const std::vector<Step> even = {{1, 0}}, odd = {{0, 1}, {2, 0}};
    return reversed_taps(layer, level, odd_row ? odd : even, odd_column ? odd : even);
}

Layers::Layers(const Sizes& sizes, const float* const* weights)
    : lateral_(weights[kLateralHalf]),
      lateral_bias_(weights[kLateralHalf + 1]),
      reduce_(weights[kReduce]),
      combined_(kMerged * kHalf),
      combined_bias_(weights[kReduce + 1], weights[kReduce + 1] + kMerged) {
    for (int i = 0; i < kLayers; ++i) layers_[i] = {weights[2 * i], weights[2 * i + 1], weight_shape(sizes, 2 * i)};
    for (int o = 0; o < kMerged; ++o) {
        for (int k = 0; k < kQuarter; ++k) {
            const float factor = reduce_[o * kQuarter + k];
            for (int i = 0; i < kHalf; ++i) combined_[o * kHalf + i] += factor * lateral_[k * kHalf + i];
            combined_bias_[o] += factor * lateral_bias_[k];
        }
    }
    layers_[kLateralHalf / 2] = {combined_.data(), combined_bias_.data(), {kMerged, kHalf, 1}};
}

void Layers::split_combined(const float* grad_weights, const float* grad_bias, float* const* out) const {
    for (int k = 0; k < kQuarter; ++k) {
        for (int i = 0; i < kHalf; ++i) {
            float sum = 0.0f;
            for (int o = 0; o < kMerged; ++o) sum += reduce_[o * kQuarter + k] * grad_weights[o * kHalf + i];
            out[kLateralHalf][k * kHalf + i] = sum;
        }
        float sum = 0.0f;
        for (int o = 0; o < kMerged; ++o) sum += reduce_[o * kQuarter + k] * grad_bias[o];
        out[kLateralHalf + 1][k] = sum;
    }
    for (int o = 0; o < kMerged; ++o) {
        for (int k = 0; k < kQuarter; ++k) {
            float sum = grad_bias[o] * lateral_bias_[k];
            for (int i = 0; i < kHalf; ++i) sum += grad_weights[o * kHalf + i] * lateral_[k * kHalf + i];
            out[kReduce][o * kQuarter + k] += sum;
        }
    }
    std::copy_n(grad_bias, kMerged, out[kReduce + 1]);
}

}  // namespace fourd::encoder
