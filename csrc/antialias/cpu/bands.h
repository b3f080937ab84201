// Divides the work of kernels that visit all pairs of neighbouring pixels of an image. Files that are compiled once per
// instruction set must not include this header, because calls of its inline functions could end up in a version that is
// compiled for another instruction set (see common/dispatch.h).
#pragma once

#include <algorithm>

#include "antialias/antialias.h"
#include "antialias/pairs.h"
#include "common/buffer.h"
#include "common/team.h"

namespace fourd::antialias {

constexpr int kRowsPerTask = 32;

inline int tasks_of(const Images& images) {
    const int bands = (images.height + kRowsPerTask - 1) / kRowsPerTask;
    return static_cast<int>(images.count) * bands;
}

inline Rows rows_of(const Images& images, int task) {
    const int bands = (images.height + kRowsPerTask - 1) / kRowsPerTask, begin = task % bands * kRowsPerTask;
    return {static_cast<std::size_t>(task / bands), begin, std::min(images.height, begin + kRowsPerTask)};
}

// Computes silhouettes_of() for all triangles of all instances, in the layout of Plan::silhouettes.
Buffer<std::uint8_t> find_silhouettes(const Mesh& mesh, std::size_t images, Simd simd, Team& team);

}  // namespace fourd::antialias
