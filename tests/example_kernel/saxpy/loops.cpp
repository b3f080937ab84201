#include "saxpy/saxpy.h"

namespace fourd::saxpy::FOURD_SIMD {
namespace {

void saxpy(float a, const float* x, const float* y, std::size_t count, float* out) {
    for (std::size_t i = 0; i < count; ++i) out[i] = a * x[i] + y[i];
}

}  // namespace

const Loops loops = {saxpy};

}  // namespace fourd::saxpy::FOURD_SIMD
