// The weights of the encoder in the layouts of the loops.
#pragma once

#include <cstddef>
#include <vector>

#include "common/buffer.h"
#include "encoder/cpu/loops.h"
#include "encoder/encoder.h"
#include "encoder/maps.h"

namespace fourd::encoder {

constexpr int kLayers = kWeightCount / 2;

inline int padded(int channels) { return (channels + kTile - 1) / kTile * kTile; }

// The taps of one convolution, with their memory.
class TapList {
  public:
    TapList() = default;
    TapList(int channels, std::vector<std::ptrdiff_t> offsets);

    float& weight(std::size_t tap, int channel) {
        return weights_[(channel / kTile * offsets_.size() + tap) * kTile + channel % kTile];
    }
    Taps taps() const { return {offsets_.data(), static_cast<int>(offsets_.size()), weights_.data()}; }
    int channels() const { return channels_; }

  private:
    int channels_ = 0;
    std::vector<std::ptrdiff_t> offsets_;
    Buffer<float> weights_;
};

// A layer's weights in torch's shape.
struct Layer {
    const float *weights, *bias;
    Shape shape;

    float weight(int output, int input, int y, int x) const {
        return weights[((static_cast<std::size_t>(output) * shape.inputs + input) * shape.side + y) * shape.side + x];
    }
};

// The offsets of a layer's taps, ordered by input channel, row and column. `level` is that of the output. With stride
// 2, the input consists of phases.
std::vector<std::ptrdiff_t> tap_offsets(const Shape& shape, const Level& level, int stride);

// The taps that compute a layer.
TapList forward_taps(const Layer& layer, const Level& level, int stride);

// The taps that compute the gradient of a layer's input from that of its output, for stride 1.
TapList backward_taps(const Layer& layer, const Level& level);

// The same for stride 2 and the pixels of the input in even or odd rows and columns.
TapList backward_phase_taps(const Layer& layer, const Level& level, bool odd_row, bool odd_column);

// All layers, where one layer stands for two that follow each other without a ReLU: kLateralHalf and kReduce. With
// weights R and L and biases r and l, R (L x + l) + r = (R L) x + (R l + r). The map that is added between the two is
// reduced before it is upsampled.
class Layers {
  public:
    Layers(const Sizes& sizes, const float* const* weights);

    const Layer& operator[](int weight) const { return layers_[weight / 2]; }

    // Splits the gradient of the combined layer: completes the gradients of kLateralHalf and kReduce, where `out` has
    // the gradient of R from the reduced quarter level. Shapes (kMerged, kHalf) and (kMerged,).
    void split_combined(const float* grad_weights, const float* grad_bias, float* const* out) const;

  private:
    Layer layers_[kLayers];
    const float *lateral_, *lateral_bias_, *reduce_;
    std::vector<float> combined_, combined_bias_;
};

}  // namespace fourd::encoder
