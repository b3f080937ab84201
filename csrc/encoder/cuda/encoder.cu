#include "encoder/cuda/encoder.h"

#include <algorithm>

#include "device/executor.h"
#include "encoder/cuda/layers.h"

namespace fourd::encoder::cuda {
namespace {

// Divides one block of memory into the maps of all images. Without memory, it only counts the floats.
class Arena {
  public:
    Arena(const Sizes& sizes, float* memory) : sizes_(sizes), memory_(memory) {}

    // A map of the size of the features, divided by `step`.
    Maps take(int channels, int step) {
        const int height = sizes_.out_height() / step, width = sizes_.out_width() / step;
        Maps out{memory_ ? memory_ + used_ : nullptr, channels, height, width, false};
        used_ += static_cast<std::size_t>(sizes_.images) * channels * height * width;
        return out;
    }
    std::size_t used() const { return used_; }

  private:
    const Sizes& sizes_;
    float* memory_;
    std::size_t used_ = 0;
};

// The results of the layers but the last, or their gradients.
struct LayerMaps {
    Maps full1, full, half1, half, quarter1, quarter, half_sum, reduced, merged;

    explicit LayerMaps(Arena& arena)
        : full1(arena.take(kFull, 1)),
          full(arena.take(kFull, 1)),
          half1(arena.take(kHalf, 2)),
          half(arena.take(kHalf, 2)),
          quarter1(arena.take(kQuarter, 4)),
          quarter(arena.take(kQuarter, 4)),
          half_sum(arena.take(kQuarter, 2)),
          reduced(arena.take(kMerged, 2)),
          merged(arena.take(kMerged, 1)) {}
};

// The maps that the layers read.
struct Saved : LayerMaps {
    Maps input;

    explicit Saved(Arena& arena) : LayerMaps(arena), input(arena.take(kColours, 1)) {}
};

using Gradients = LayerMaps;

class Pass {
  public:
    Pass(const Sizes& sizes, const float* const* weights, void* stream)
        : sizes_(sizes), weights_(weights), executor_(stream) {}

    void pool(const float* images, const Maps& out) const {
        executor_.for_each(pixels(out) * out.channels, Pool{images, sizes_.stride, out});
    }

    void convolve(int weight, const Maps& in, const Maps& out, bool rectifies, int stride = 1) const {
        const Shape shape = weight_shape(sizes_, weight);
        executor_.for_each(pixels(out) * tiles(shape.outputs),
                           Convolve{in, out, weights_[weight], weights_[weight + 1], shape, stride, rectifies});
    }

    void add_upsampled(const Maps& coarse, const Maps& out) const {
        executor_.for_each(pixels(out) * out.channels, AddUpsampled{coarse, out});
    }

    void convolve_backward(int weight, const Maps& gradient, const Maps& out, const Maps* mask = nullptr,
                           int stride = 1) const {
        const Shape shape = weight_shape(sizes_, weight);
        executor_.for_each(pixels(out) * tiles(shape.inputs),
                           ConvolveBackward{gradient, out, weights_[weight], shape, stride,
                                            mask ? mask->data : nullptr, stride > 1});
    }

    void upsampled_backward(const Maps& fine, const Maps& out) const {
        executor_.for_each(pixels(out) * out.channels, UpsampledBackward{fine, out, nullptr});
    }

    const device::Executor& executor() const { return executor_; }

    std::size_t pixels(const Maps& maps) const {
        return static_cast<std::size_t>(sizes_.images) * maps.height * maps.width;
    }

  private:
    static int tiles(int channels) { return (channels + kTile - 1) / kTile; }

    const Sizes& sizes_;
    const float* const* weights_;
    const device::Executor executor_;
};

Maps features_of(const Sizes& sizes, float* features) {
    return {features, sizes.features, sizes.out_height(), sizes.out_width(), true};
}

void add_weight_gradients(const Sizes& sizes, const Saved& in, const Gradients& by, const Maps& features,
                          const Pass& pass, float* const* out) {
    const Maps inputs[kLayers] = {in.input,    in.full1, in.full, in.half1,    in.half,
                                  in.quarter1, in.half,  in.full, in.half_sum, in.merged};
    const Maps gradients[kLayers] = {by.full1,   by.full,     by.half1,  by.half,    by.quarter1,
                                     by.quarter, by.half_sum, by.merged, by.reduced, features};
    WeightGradients kernel{};
    ClearWeights clear{};
    std::size_t end = 0, largest = 0;
    for (int i = 0; i < kLayers; ++i) {
        const Shape shape = weight_shape(sizes, 2 * i);
        const int stride = 2 * i == kHalfFirst || 2 * i == kQuarterFirst ? 2 : 1;
        end += static_cast<std::size_t>(shape.outputs) * shape.inputs * sizes.images * gradients[i].height;
        kernel.layers[i] = {inputs[i], gradients[i], shape, stride, out[2 * i], out[2 * i + 1], end};
    }
    for (int i = 0; i < kWeightCount; ++i) {
        clear.weights[i] = out[i];
        clear.sizes[i] = weight_shape(sizes, i).size();
        largest = std::max(largest, clear.sizes[i]);
    }
    pass.executor().for_each(largest * kWeightCount, clear);
    pass.executor().for_each(end, kernel);
}

}  // namespace

std::size_t saved_size(const Sizes& sizes) {
    Arena arena(sizes, nullptr);
    const Saved maps(arena);
    return arena.used();
}

std::size_t workspace_size(const Sizes& sizes) {
    Arena arena(sizes, nullptr);
    const Gradients maps(arena);
    return arena.used();
}

void forward(const Sizes& sizes, const float* const* weights, const float* images, float* features, float* saved,
             void* stream) {
    Arena arena(sizes, saved);
    const Saved maps(arena);
    const Pass pass(sizes, weights, stream);
    pass.pool(images, maps.input);
    pass.convolve(kFullFirst, maps.input, maps.full1, true);
    pass.convolve(kFullSecond, maps.full1, maps.full, true);
    pass.convolve(kHalfFirst, maps.full, maps.half1, true, 2);
    pass.convolve(kHalfSecond, maps.half1, maps.half, true);
    pass.convolve(kQuarterFirst, maps.half, maps.quarter1, true, 2);
    pass.convolve(kQuarterSecond, maps.quarter1, maps.quarter, true);
    pass.convolve(kLateralHalf, maps.half, maps.half_sum, false);
    pass.add_upsampled(maps.quarter, maps.half_sum);
    pass.convolve(kReduce, maps.half_sum, maps.reduced, false);
    pass.convolve(kLateralFull, maps.full, maps.merged, false);
    pass.add_upsampled(maps.reduced, maps.merged);
    pass.convolve(kOut, maps.merged, features_of(sizes, features), false);
}

void backward(const Sizes& sizes, const float* const* weights, const float* saved, const float* grad_features,
              float* workspace, float* const* out, void* stream) {
    // The arrays are only read.
    Arena saved_arena(sizes, const_cast<float*>(saved)), arena(sizes, workspace);
    const Saved maps(saved_arena);
    const Gradients to(arena);
    const Maps features = features_of(sizes, const_cast<float*>(grad_features));
    const Pass pass(sizes, weights, stream);
    pass.convolve_backward(kOut, features, to.merged);
    pass.convolve_backward(kLateralFull, to.merged, to.full);
    pass.upsampled_backward(to.merged, to.reduced);
    pass.convolve_backward(kReduce, to.reduced, to.half_sum);
    pass.convolve_backward(kLateralHalf, to.half_sum, to.half);
    pass.executor().for_each(pass.pixels(to.quarter) * kQuarter,
                             UpsampledBackward{to.half_sum, to.quarter, maps.quarter.data});
    pass.convolve_backward(kQuarterSecond, to.quarter, to.quarter1, &maps.quarter1);
    pass.convolve_backward(kQuarterFirst, to.quarter1, to.half, &maps.half, 2);
    pass.convolve_backward(kHalfSecond, to.half, to.half1, &maps.half1);
    pass.convolve_backward(kHalfFirst, to.half1, to.full, &maps.full, 2);
    pass.convolve_backward(kFullSecond, to.full, to.full1, &maps.full1);
    add_weight_gradients(sizes, maps, to, features, pass, out);
}

}  // namespace fourd::encoder::cuda
