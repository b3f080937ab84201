// Kernels that render images or compute the largest weight of each point. Each pixel of a tile has one thread
// (tiles/cuda/traversal.h), even if the pixel is outside the image.
#pragma once

#include "points/cuda/project.h"

namespace fourd::points::cuda {

// The inputs that all kernels with one thread per pixel have in common.
struct View {
    Entries entries;
    int width, height, layers;
    float transmittance_min;

    FOURD_DEVICE Pixel pixel(std::size_t index) const { return pixel_of(index, entries.tiles, width, height); }
};

// Computes the depth of a pixel from the depths and weights of its layers. Depths are stored relative to the depth of
// the nearest layer, to limit rounding errors when weights are small.
struct DepthSum {
    float nearest = -1.0f, weight = 0.0f, behind = 0.0f;

    FOURD_DEVICE void add(float z, float w) {
        if (nearest < 0.0f) nearest = z;
        weight += w;
        behind += w * (z - nearest);
    }

    // Returns the mean depth minus `nearest`. Call this function only if the alpha of the pixel is above 0, because
    // otherwise `weight` may be 0.
    FOURD_DEVICE float mean_behind() const { return behind / weight; }
};

// Composites the features of a pixel and writes them with the pixel's alpha and depth. kCapacity must be at least the
// number of channels. Loops up to the constant kCapacity can be unrolled, so the compiler can keep arrays in registers.
template <int kCapacity>
struct RenderPixel {
    View view;
    const float* features;  // Indexed by point.
    int channels;
    Image out;

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const Pixel pixel = view.pixel(index);
        float colour[kCapacity] = {};
        DepthSum depth;
        const float transmittance = traverse(
            view.entries, entry_list(view.entries, pixel.tile), pixel, view.layers, view.transmittance_min, lane,
            [&](std::size_t, std::size_t rank, const Splat& splat, const PixelCoverage& coverage,
                float transmittance_before) {
                const float weight = transmittance_before * coverage.alpha;
                const float* feature = features + static_cast<std::size_t>(view.entries.indices[rank]) * channels;
                for (int c = 0; c < kCapacity; ++c) {
                    if (c < channels) colour[c] += weight * feature[c];
                }
                depth.add(splat.z, weight);
            });
        if (!pixel.inside) return;
        const float alpha = 1.0f - transmittance;
        for (int c = 0; c < kCapacity; ++c) {
            if (c < channels) out.features[pixel.index * channels + c] = colour[c];
        }
        out.alpha[pixel.index] = alpha;
        out.depth[pixel.index] = alpha > 0.0f ? depth.nearest + depth.mean_behind() : 0.0f;
    }
};

FOURD_DEVICE static inline std::uint8_t byte_of(float value) {
    value = value > 0.0f ? value : 0.0f;
    return static_cast<std::uint8_t>((value < 1.0f ? value : 1.0f) * 255.0f + 0.5f);
}

struct DrawPixel {
    View view;
    const float* features;  // Shape (count, 3).
    Canvas out;

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const Pixel pixel = view.pixel(index);
        float colour[3] = {};
        const float transmittance = traverse(
            view.entries, entry_list(view.entries, pixel.tile), pixel, view.layers, view.transmittance_min, lane,
            [&](std::size_t, std::size_t rank, const Splat&, const PixelCoverage& coverage,
                float transmittance_before) {
                const float* feature = features + 3 * static_cast<std::size_t>(view.entries.indices[rank]);
                for (int c = 0; c < 3; ++c) colour[c] += transmittance_before * coverage.alpha * feature[c];
            });
        if (!pixel.inside) return;
        std::uint8_t* to = out.rgba + 4 * pixel.index;
        for (int c = 0; c < 3; ++c) to[c] = byte_of(colour[c] + transmittance * out.background[c]);
        to[3] = byte_of(1.0f - transmittance);
    }
};

struct VisibilityPixel {
    View view;
    float* out;  // Indexed by point, initially 0.

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const Pixel pixel = view.pixel(index);
        traverse(view.entries, entry_list(view.entries, pixel.tile), pixel, view.layers, 0.0f, lane,
                 [&](std::size_t, std::size_t rank, const Splat&, const PixelCoverage& coverage,
                     float transmittance_before) {
                     device::atomic_max(out + view.entries.indices[rank], transmittance_before * coverage.alpha);
                 });
    }
};

}  // namespace fourd::points::cuda
