// The arithmetic of the image encoder that the CPU and GPUs share: bilinear upsampling by a factor of two.
#pragma once

#include "common/host_device.h"
#include "common/inline.h"

namespace fourd::encoder {

// Weights of the nearer and the farther sample in bilinear upsampling by a factor of two. The positions of samples are
// the centres of pixels, as in torch with align_corners=False.
constexpr float kNear = 0.75f, kFar = 0.25f;

// Returns the row or column inside a map that is nearest to an index that may be outside.
FOURD_HD FOURD_INLINE int clamp_index(int index, int size) { return index < 0 ? 0 : index < size ? index : size - 1; }

// Returns the farther of the two coarse rows or columns of which a fine one is the weighted mean. The nearer is
// fine / 2.
FOURD_HD FOURD_INLINE int farther_index(int fine, int coarse_size) {
    return clamp_index(fine / 2 + (fine % 2 == 0 ? -1 : 1), coarse_size);
}

// Weight of the k-th of the four fine rows or columns from 2 * coarse - 1 on, in the gradient of a coarse one. A row
// outside the map, which clamp_index replaces by the outermost one, has the weight of the coarse sample that is clamped.
FOURD_HD FOURD_INLINE float child_weight(int k) { return k == 1 || k == 2 ? kNear : kFar; }

}  // namespace fourd::encoder
