// Code that the CUDA kernels of antialiasing and of edge gradients share: the kernel that finds the silhouette edges of
// all triangles, and the conversion of a thread index to a pixel.
#pragma once

#include "antialias/pairs.h"
#include "device/executor.h"

namespace fourd::antialias::cuda {

inline std::size_t instances_of(const Mesh& mesh, std::size_t images) { return mesh.instanced ? images : 1; }

struct FindSilhouettes {
    Mesh mesh;
    std::uint8_t* out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const std::size_t instance = index / mesh.triangle_count;
        out[index] = silhouettes_of(mesh, mesh.first_vertex(instance), index % mesh.triangle_count);
    }
};

// The image, row and column of a pixel, from its index among the pixels of all images.
struct Place {
    std::size_t image;
    int row, column;

    FOURD_DEVICE Place(const Images& images, std::size_t index)
        : image(index / images.pixels()),
          row(static_cast<int>(index % images.pixels() / images.width)),
          column(static_cast<int>(index % images.width)) {}
};

}  // namespace fourd::antialias::cuda
