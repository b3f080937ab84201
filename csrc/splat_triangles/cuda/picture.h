// Kernels that project triangles and render images. Each pixel of a tile has one thread (tiles/cuda/traversal.h), even
// if the pixel is outside the image.
#pragma once

#include <cstring>

#include "splat_triangles/cuda/render.h"
#include "tiles/cuda/traversal.h"

namespace fourd::splat_triangles::cuda {

using Entries = tiles::cuda::Entries<Splat>;
using tiles::cuda::Pixel;

struct ProjectTriangle {
    Mesh mesh;
    tiles::Pinhole camera;
    float near_depth;
    Entries to;

    FOURD_DEVICE void operator()(std::size_t triangle) const {
        const auto at = project(camera, near_depth, corners_of(camera, mesh.xyz, mesh.tri + 3 * triangle),
                                mesh.opacity[triangle], mesh.sigma[triangle]);
        std::uint32_t key = tiles::cuda::kCulled;
        Splat splat{};
        if (at.visible) {
            memcpy(&key, &at.z, sizeof key);
            splat.x = at.x;
            splat.y = at.y;
            for (int k = 0; k < 3; ++k) {
                splat.slope_x[k] = at.slope_x[k];
                splat.slope_y[k] = at.slope_y[k];
            }
            splat.opacity = mesh.opacity[triangle];
            splat.sigma = mesh.sigma[triangle];
            splat.smallest = at.smallest;
            splat.z = at.z;
            splat.range = {static_cast<std::uint16_t>(at.left), static_cast<std::uint16_t>(at.right),
                           static_cast<std::uint16_t>(at.top), static_cast<std::uint16_t>(at.bottom)};
        }
        to.by_index[triangle] = splat;
        to.keys[triangle] = key;
        to.values[triangle] = static_cast<std::uint32_t>(triangle);
    }
};

// The inputs that all kernels with one thread per pixel have in common.
struct View {
    Entries entries;
    int width, height, layers;
    const float* values;  // Features, then geometry (normal and depth), indexed by triangle.
    int channels;         // Number of values per triangle.
    int features;         // Number of features, without the geometry.
    bool geometry;

    FOURD_DEVICE Pixel pixel(std::size_t index) const {
        return tiles::cuda::pixel_of(index, entries.tiles, width, height);
    }

    FOURD_DEVICE const float* values_of(std::size_t rank) const {
        return values + static_cast<std::size_t>(entries.indices[rank]) * channels;
    }
};

// Renders a pixel, and updates the largest compositing weight of each triangle that hits it. kCapacity must be at least
// the number of channels. Loops up to the constant kCapacity can be unrolled, so the compiler can keep arrays in
// registers.
template <int kCapacity>
struct RenderPixel {
    View view;
    Image out;
    float* weight;  // Largest compositing weight of each triangle, initially 0.

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const Pixel pixel = view.pixel(index);
        float sums[kCapacity] = {};
        const float transmittance = tiles::cuda::traverse(
            view.entries, tiles::cuda::entry_list(view.entries, pixel.tile), pixel, view.layers, kMinTransmittance,
            lane,
            [&](std::size_t, std::size_t rank, const Splat&, const PixelCoverage& coverage,
                float transmittance_before) {
                const float here = transmittance_before * coverage.alpha;
                const float* value = view.values_of(rank);
                for (int c = 0; c < kCapacity; ++c) {
                    if (c < view.channels) sums[c] += here * value[c];
                }
                device::atomic_max(weight + view.entries.indices[rank], here);
            });
        if (!pixel.inside) return;
        const float alpha = 1.0f - transmittance;
        out.alpha[pixel.index] = alpha;
        out.transmittance[pixel.index] = transmittance;
        for (int c = 0; c < kCapacity; ++c) {
            if (c < view.features) {
                out.features[pixel.index * view.features + c] = sums[c];
            } else if (c < view.features + 3 && view.geometry) {
                out.normal[3 * pixel.index + c - view.features] = sums[c];
            } else if (c < view.channels) {
                out.depth[pixel.index] = alpha > 0.0f ? sums[c] / alpha : 0.0f;
            }
        }
    }
};

}  // namespace fourd::splat_triangles::cuda
