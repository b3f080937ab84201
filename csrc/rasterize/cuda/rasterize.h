// The rasterizer (rasterize/rasterize.h) on a GPU. Functions queue work on a stream and do not wait for the GPU. All
// arrays are in GPU memory. `longest_range` is the largest number of triangles that any image has.
#pragma once

#include "rasterize/rasterize.h"

namespace fourd::rasterize::cuda {

// Returns the size in bytes of the `workspace` that rasterize() needs.
std::size_t workspace_bytes(std::size_t images, std::size_t height, std::size_t width, std::size_t longest_range);

void rasterize(const Query& query, std::size_t longest_range, void* workspace, const float* previous, float* rast,
               float* rast_db, void* stream);

// The order of the additions over pixels is not fixed, so the last bits of the gradient can differ between calls.
void rasterize_backward(const Query& query, const float* rast, const float* grad_rast, const float* grad_db,
                        float* grad_pos, void* stream);

}  // namespace fourd::rasterize::cuda
