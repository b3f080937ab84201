// Interpolates vertex attributes over rasterized triangles. Callers check shapes. Every pointer points to a dense
// row-major array.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/host_device.h"
#include "common/simd.h"

namespace fourd::interpolate {

struct Query {
    const float* attr;         // Shape (images or 1, vertices, channels).
    std::size_t vertices;
    std::size_t channels;
    // The attributes of image i start at vertex i * image_stride of `attr`. If all images share the attributes,
    // image_stride is 0.
    std::size_t image_stride;
    const std::int32_t* tri;   // Shape (triangles, 3): vertex indices.
    std::size_t triangles;
    const float* rast;         // Shape (images, height, width, 4): u, v, an unused number, and the encoded triangle id.
    const float* rast_db;      // Shape (images, height, width, 4): du/dX, du/dY, dv/dX, dv/dY; null if diff_count is 0.
    int images, height, width;
    // Shape (diff_count,): the channels whose derivatives are computed. All indices are below `channels`.
    const std::int32_t* diff;
    std::size_t diff_count;
    int threads;  // At least 1. The result is the same for any number of threads.
    Simd simd;    // An instruction set that this machine supports.

    FOURD_HD std::size_t pixels() const { return static_cast<std::size_t>(height) * static_cast<std::size_t>(width); }
    FOURD_HD const float* attr_of(std::size_t image) const { return attr + image * image_stride * channels; }
};

// Writes the attributes to `out` (images, height, width, channels), and their derivatives along x and y to `out_da`
// (images, height, width, 2 * diff_count). All outputs are 0 at background pixels, and at pixels whose triangle index is
// out of range.
void interpolate(const Query& query, float* out, float* out_da);

// The gradients of the outputs, and the arrays that receive the gradients of the inputs.
struct Gradients {
    const float* out;     // Shape (images, height, width, channels).
    const float* out_da;  // Shape (images, height, width, 2 * diff_count); null if diff_count is 0.
    float* attr;          // Null, or an array with the shape of Query::attr.
    float* rast;          // Shape (images, height, width, 4), or null. The last two channels are set to 0.
    float* rast_db;       // Shape (images, height, width, 4), or null.
};

// Computes the gradients of the inputs. The arrays that receive them are overwritten.
void interpolate_backward(const Query& query, const Gradients& gradients);

}  // namespace fourd::interpolate
