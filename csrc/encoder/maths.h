// The arithmetic of the image encoder's resampling: pooling and bilinear upsampling by a factor of two.
#pragma once

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd::encoder {

// Weights of the nearer and the farther sample in bilinear upsampling by a factor of two. The positions of samples are
// the centres of pixels, as in torch with align_corners=False.
constexpr float kNear = 0.75f, kFar = 0.25f;

// Returns the row or column inside a map that is nearest to an index that may be outside.
FOURD_HD FOURD_INLINE int clamp_index(int index, int size) { return index < 0 ? 0 : index < size ? index : size - 1; }

}  // namespace fourd::encoder
