// Random inputs of the image encoder.
#pragma once

#include <vector>

#include "encoder/encoder.h"
#include "tests/random_inputs.h"

namespace fourd::tests {

struct EncoderInputs {
    encoder::Sizes sizes;
    float hostile;  // Share of invalid numbers in the images.
    Floats images, features;
    std::vector<Floats> weights, gradients;
    std::vector<const float*> layers;
    std::vector<float*> out;

    explicit EncoderInputs(unsigned seed) : sizes{}, hostile(seed % 2 ? 0.2f : 0.0f) {
        Random random(seed);
        const int stride = random_int(random, 1, 2), step = 4 * stride;
        sizes = {random_int(random, 0, 3), step * random_int(random, 1, 6), step * random_int(random, 1, 6), stride,
                 random_int(random, 1, 20)};
        const std::size_t pixels = static_cast<std::size_t>(sizes.images) * sizes.height * sizes.width;
        images = random_floats(random, 3 * pixels, 0, 1, hostile);
        features.resize(pixels / stride / stride * sizes.features);
        for (int i = 0; i < encoder::kWeightCount; ++i) {
            weights.push_back(random_floats(random, encoder::weight_shape(sizes, i).size(), -1, 1, 0));
            gradients.push_back(weights.back());
        }
        for (int i = 0; i < encoder::kWeightCount; ++i) {
            layers.push_back(weights[i].data());
            out.push_back(gradients[i].data());
        }
    }

    void expect_finite_results(unsigned seed) const {
        if (hostile > 0) return;
        expect_finite(features, "features of images", seed);
        for (const Floats& gradient : gradients) expect_finite(gradient, "gradients of the encoder's weights", seed);
    }
};

inline void run_encoder(unsigned seed, const char* simd) {
    EncoderInputs inputs(seed);
    const encoder::Sizes& sizes = inputs.sizes;
    Floats saved(sizes.images * encoder::saved_size(sizes));
    const encoder::Execution execution{static_cast<int>(seed % 4) + 1, simd_named(simd)};
    const float *const *layers = inputs.layers.data(), *images = inputs.images.data();
    encoder::forward(sizes, layers, images, execution, inputs.features.data(), nullptr);
    encoder::forward(sizes, layers, images, execution, inputs.features.data(), saved.data());
    encoder::backward(sizes, layers, saved.data(), inputs.features.data(), execution, inputs.out.data());
    inputs.expect_finite_results(seed);
}

}  // namespace fourd::tests
