// Convolutions process successive positions in the lanes of a vector, and several channels at once, so that each vector
// of the input is used several times. The sums stay in registers.
#include "encoder/cpu/loops.h"

#include <cstring>
#include <limits>

#include "common/inline.h"
#include "encoder/maths.h"

namespace fourd::encoder::FOURD_SIMD {
namespace {

#include "vectors/native.inc"
#include "encoder/cpu/convolution.inc"
#include "encoder/cpu/resampling.inc"

void to_pixels(const float* planes, std::size_t plane, int channels, int width, float* out) {
    for (int x = 0; x < width; ++x) {
        for (int c = 0; c < channels; ++c) out[static_cast<std::size_t>(x) * channels + c] = planes[c * plane + x];
    }
}

void to_planes(const float* pixels, int channels, int width, float* out, std::size_t plane) {
    for (int c = 0; c < channels; ++c) {
        for (int x = 0; x < width; ++x) out[c * plane + x] = pixels[static_cast<std::size_t>(x) * channels + c];
    }
}

}  // namespace

const Loops loops = {convolve,     correlate,  pool,      add_upsampled, upsampled_backward,
                     split_phases, add_phases, to_pixels, to_planes};

}  // namespace fourd::encoder::FOURD_SIMD
