// Rasterizes triangles that are given in clip space. Callers check shapes. Every pointer points to a dense row-major
// array.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/host_device.h"
#include "common/simd.h"

namespace fourd::rasterize {

constexpr int kLongestSide = 1 << 15;  // Largest image side in pixels.

struct Query {
    const float* pos;            // Shape (images or 1, vertices, 4): clip coordinates x, y, z, w.
    std::size_t vertices;        // Number of vertices of an image.
    // The positions of image i start at vertex i * image_stride of `pos`. If all images share the positions,
    // image_stride is 0.
    std::size_t image_stride;
    const std::int32_t* tri;     // Shape (triangles, 3): vertex indices of each triangle.
    std::size_t triangles;       // At most kMaxTriangles (common/triangle_id.h).
    // Shape (images, 2): index of each image's first triangle, and count of its triangles. If `ranges` is null, each
    // image has all triangles.
    const std::int32_t* ranges;
    int images, height, width;   // Images have sides from 1 to kLongestSide.
    int threads;                 // At least 1. The result is the same for any number of threads.
    Simd simd;                   // An instruction set that this machine supports.

    FOURD_HD std::size_t pixels() const { return static_cast<std::size_t>(height) * static_cast<std::size_t>(width); }
    FOURD_HD const float* pos_of(std::size_t image) const { return pos + 4 * image * image_stride; }
};

// Writes u, v, z/w and the encoded id (common/triangle_id.h) of the nearest triangle to `rast` (images, height, width,
// 4). u and v are the barycentric weights of the triangle's vertices 0 and 1. Writes the derivatives du/dX, du/dY,
// dv/dX and dv/dY to `rast_db` (images, height, width, 4), which may be null. X and Y are the pixel coordinates along a
// row and a column. If `previous` is not null, it must be the `rast` of a previous call, and each pixel gets the next
// triangle behind the one that it has in `previous`. Triangles with equal z/w are ordered by id.
void rasterize(const Query& query, const float* previous, float* rast, float* rast_db);

// Overwrites grad_pos with the gradient of the loss with respect to pos. grad_rast and grad_db (images, height, width,
// 4) are the gradients of the loss with respect to rast and rast_db. grad_db may be null. Of grad_rast, only the
// gradients with respect to u and v are used. Those with respect to z/w and the triangle id are ignored.
void rasterize_backward(const Query& query, const float* rast, const float* grad_rast, const float* grad_db,
                        float* grad_pos);

}  // namespace fourd::rasterize
