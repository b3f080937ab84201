// The layers of the image encoder as kernels. Each kernel computes one number per index, or kTile channels of a pixel.
#pragma once

#include <cstddef>

#include "device/lane.h"
#include "encoder/encoder.h"
#include "encoder/maths.h"

namespace fourd::encoder::cuda {

constexpr int kTile = 8;  // Output channels that a thread computes from the same inputs.

// Feature maps of all images. The channels are separate planes, or the channels of a pixel are adjacent.
struct Maps {
    float* data;
    int channels, height, width;
    bool by_pixel;

    FOURD_DEVICE std::size_t index(std::size_t image, int channel, int y, int x) const {
        if (by_pixel) return ((image * height + y) * width + x) * channels + channel;
        return ((image * channels + channel) * height + y) * width + x;
    }
    FOURD_DEVICE float& at(std::size_t image, int channel, int y, int x) const {
        return data[index(image, channel, y, x)];
    }
    FOURD_DEVICE bool contains(int y, int x) const { return y >= 0 && y < height && x >= 0 && x < width; }
};

// A pixel of a map, and one of several parts of its channels.
struct Place {
    int x, y, part;
    std::size_t image;
};

FOURD_DEVICE inline Place place_of(std::size_t index, const Maps& maps, int parts) {
    const std::size_t row = index / maps.width, rest = row / maps.height;
    return {static_cast<int>(index % maps.width), static_cast<int>(row % maps.height), static_cast<int>(rest % parts),
            rest / parts};
}

FOURD_DEVICE inline std::size_t weight_index(const Shape& shape, int output, int input, int y, int x) {
    return ((static_cast<std::size_t>(output) * shape.inputs + input) * shape.side + y) * shape.side + x;
}

FOURD_DEVICE inline int tiles_of(int channels) { return (channels + kTile - 1) / kTile; }

// Averages squares of `stride` x `stride` pixels.
struct Pool {
    const float* images;
    int stride;
    Maps out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place at = place_of(index, out, out.channels);
        const int width = out.width * stride, height = out.height * stride;
        const float* plane = images + (at.image * out.channels + at.part) * height * width;
        float sum = 0.0f;
        for (int y = 0; y < stride; ++y) {
            for (int x = 0; x < stride; ++x) {
                sum += plane[static_cast<std::size_t>(at.y * stride + y) * width + at.x * stride + x];
            }
        }
        out.at(at.image, at.part, at.y, at.x) = sum / static_cast<float>(stride * stride);
    }
};

struct Convolve {
    Maps in, out;
    const float *weights, *bias;
    Shape shape;
    int stride;
    bool rectifies;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place at = place_of(index, out, tiles_of(shape.outputs));
        const int first = at.part * kTile;
        const int count = shape.outputs - first < kTile ? shape.outputs - first : kTile;
        float sums[kTile] = {};
        for (int c = 0; c < count; ++c) sums[c] = bias[first + c];
        for (int i = 0; i < shape.inputs; ++i) {
            for (int ky = 0; ky < shape.side; ++ky) {
                for (int kx = 0; kx < shape.side; ++kx) {
                    const int y = at.y * stride + ky - shape.side / 2, x = at.x * stride + kx - shape.side / 2;
                    if (!in.contains(y, x)) continue;
                    const float value = in.at(at.image, i, y, x);
                    for (int c = 0; c < count; ++c) {
                        sums[c] += weights[weight_index(shape, first + c, i, ky, kx)] * value;
                    }
                }
            }
        }
        for (int c = 0; c < count; ++c) {
            out.at(at.image, first + c, at.y, at.x) = rectifies && !(sums[c] > 0.0f) ? 0.0f : sums[c];
        }
    }
};

// The gradient of a convolution's input. Where `mask` is not positive, the gradient is 0.
struct ConvolveBackward {
    Maps gradient, out;
    const float* weights;
    Shape shape;
    int stride;
    const float* mask;  // In the shape of `out`, or null.
    bool adds;          // The gradient is added to `out` before it is masked.

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place at = place_of(index, out, tiles_of(shape.inputs));
        const int first = at.part * kTile;
        const int count = shape.inputs - first < kTile ? shape.inputs - first : kTile;
        float sums[kTile] = {};
        for (int o = 0; o < shape.outputs; ++o) {
            for (int ky = 0; ky < shape.side; ++ky) {
                for (int kx = 0; kx < shape.side; ++kx) {
                    const int y = at.y + shape.side / 2 - ky, x = at.x + shape.side / 2 - kx;
                    if (y % stride != 0 || x % stride != 0 || !gradient.contains(y / stride, x / stride)) continue;
                    const float value = gradient.at(at.image, o, y / stride, x / stride);
                    for (int c = 0; c < count; ++c) {
                        sums[c] += weights[weight_index(shape, o, first + c, ky, kx)] * value;
                    }
                }
            }
        }
        for (int c = 0; c < count; ++c) {
            const std::size_t to = out.index(at.image, first + c, at.y, at.x);
            const float sum = adds ? out.data[to] + sums[c] : sums[c];
            out.data[to] = mask && !(mask[to] > 0.0f) ? 0.0f : sum;
        }
    }
};

// Adds a map, upsampled by a factor of two.
struct AddUpsampled {
    Maps coarse, out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place at = place_of(index, out, out.channels);
        const int y = at.y / 2, x = at.x / 2;
        const int far_y = farther_index(at.y, coarse.height), far_x = farther_index(at.x, coarse.width);
        const float near = kNear * coarse.at(at.image, at.part, y, x) + kFar * coarse.at(at.image, at.part, far_y, x);
        const float far =
            kNear * coarse.at(at.image, at.part, y, far_x) + kFar * coarse.at(at.image, at.part, far_y, far_x);
        out.at(at.image, at.part, at.y, at.x) += kNear * near + kFar * far;
    }
};

// The gradient of AddUpsampled::coarse. Where `mask` is not positive, the gradient is 0.
struct UpsampledBackward {
    Maps fine, out;
    const float* mask;  // In the shape of `out`, or null.

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place at = place_of(index, out, out.channels);
        float sum = 0.0f;
        for (int ky = 0; ky < 4; ++ky) {
            const int y = clamp_index(2 * at.y - 1 + ky, fine.height);
            for (int kx = 0; kx < 4; ++kx) {
                const int x = clamp_index(2 * at.x - 1 + kx, fine.width);
                sum += child_weight(ky) * child_weight(kx) * fine.at(at.image, at.part, y, x);
            }
        }
        const std::size_t to = out.index(at.image, at.part, at.y, at.x);
        out.data[to] = mask && !(mask[to] > 0.0f) ? 0.0f : sum;
    }
};

constexpr int kLayers = kWeightCount / 2;

// The gradients of all weights. Each index stands for one kernel of one layer in one row of the gradient of one image.
struct WeightGradients {
    struct Layer {
        Maps in, gradient;
        Shape shape;
        int stride;
        float *weights, *bias;
        std::size_t end;  // Of the layer's indices.
    };
    Layer layers[kLayers];

    FOURD_DEVICE void operator()(std::size_t index) const {
        int number = 0;
        while (index >= layers[number].end) ++number;
        const Layer& layer = layers[number];
        const Shape& shape = layer.shape;
        const std::size_t place = index - (number > 0 ? layers[number - 1].end : 0);
        const int output = static_cast<int>(place % shape.outputs);
        const std::size_t rest = place / shape.outputs, row = rest / shape.inputs;
        const int input = static_cast<int>(rest % shape.inputs), y = static_cast<int>(row % layer.gradient.height);
        add(layer, output, input, row / layer.gradient.height, y);
    }

  private:
    FOURD_DEVICE static void add(const Layer& layer, int output, int input, std::size_t image, int y) {
        const Shape& shape = layer.shape;
        float sums[9] = {}, total = 0.0f;
        for (int x = 0; x < layer.gradient.width; ++x) {
            const float gradient = layer.gradient.at(image, output, y, x);
            total += gradient;
            for (int k = 0; k < shape.side * shape.side; ++k) {
                const int from_y = y * layer.stride + k / shape.side - shape.side / 2;
                const int from_x = x * layer.stride + k % shape.side - shape.side / 2;
                if (layer.in.contains(from_y, from_x)) sums[k] += gradient * layer.in.at(image, input, from_y, from_x);
            }
        }
        float* to = layer.weights + weight_index(shape, output, input, 0, 0);
        for (int k = 0; k < shape.side * shape.side; ++k) device::atomic_add(to + k, sums[k]);
        if (input == 0) device::atomic_add(layer.bias + output, total);
    }
};

// Sets the gradients of all weights to zero. Each index stands for one number of one array, of which some have fewer
// numbers than others.
struct ClearWeights {
    float* weights[kWeightCount];
    std::size_t sizes[kWeightCount];

    FOURD_DEVICE void operator()(std::size_t index) const {
        const std::size_t place = index / kWeightCount;
        const int number = static_cast<int>(index % kWeightCount);
        if (place < sizes[number]) weights[number][place] = 0.0f;
    }
};

}  // namespace fourd::encoder::cuda
