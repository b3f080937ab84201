// Computes the backward pass of an image with two kernels: one over pixels, then one over points.
#pragma once

#include "points/cuda/picture.h"

namespace fourd::points::cuda {

// The gradient of the loss with respect to the image, at one pixel. The layers of a pixel are the points that are
// composited at this pixel. From the gradient, GradientPixel computes the "value" of each layer: the derivative of the
// loss with respect to the layer's weight, without the contribution of the pixel's alpha. points/cpu/gradient.inc has
// the formulas, and explains why this contribution is left out.
template <int kCapacity>
struct Upstream {
    float colour[kCapacity];
    float alpha, depth;

    FOURD_DEVICE Upstream(const ImageGradient& gradient, const Pixel& pixel, int channels) {
        for (int c = 0; c < kCapacity; ++c) {
            colour[c] = pixel.inside && c < channels ? gradient.features[pixel.index * channels + c] : 0.0f;
        }
        alpha = pixel.inside ? gradient.alpha[pixel.index] : 0.0f;
        depth = pixel.inside && gradient.depth ? gradient.depth[pixel.index] : 0.0f;
    }
};

// A thread composites its pixel front to back and records the layers, then processes the recorded layers back to front.
// During this back-to-front pass, all threads of a warp process the same entry (point of the tile) at the same time.
// The warp processes every entry that at least one of its threads recorded.
template <int kCapacity, int kLayers>
struct GradientPixel {
    View view;              // Requires view.layers <= kLayers.
    const float* features;  // Indexed by point.
    int channels;
    ImageGradient gradient;

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const Pixel pixel = view.pixel(index);
        const EntryList list = entry_list(view.entries, pixel.tile);
        std::uint32_t positions[kLayers];
        float transmittances[kLayers];
        int count = 0;
        DepthSum depth;
        // The traversal continues even at a transmittance of exactly 0, because the gradient of a point with alpha 1
        // depends on the points behind it.
        const float transmittance = traverse(view.entries, list, pixel, view.layers, -1.0f, lane,
                                             [&](std::size_t position, std::size_t, const Splat& splat,
                                                 const PixelCoverage& coverage, float transmittance_before) {
                                                 positions[count] = static_cast<std::uint32_t>(position);
                                                 transmittances[count] = transmittance_before;
                                                 ++count;
                                                 depth.add(splat.z, transmittance_before * coverage.alpha);
                                             });
        const bool seen = 1.0f - transmittance > 0.0f;
        const Upstream<kCapacity> upstream(gradient, pixel, channels);
        const float per_weight = seen ? upstream.depth / depth.weight : 0.0f;
        const float mean_behind = seen ? depth.mean_behind() : 0.0f;
        // The values (variable `value` below) of all layers behind the current layer, composited front to back with the
        // alphas of these layers.
        float behind = 0.0f;
        float transmittance_behind = 1.0f;  // Transmittance of the layers behind the current layer.
        while (true) {
            const std::uint32_t own_entry = count > 0 ? positions[count - 1] + 1 : 0;
            const std::uint32_t next_entry = lane.max(own_entry);
            if (next_entry == 0) break;
            const std::size_t rank = list.rank(next_entry - 1);
            // The members of SplatGradient, followed by the gradients of the features.
            float parts[5 + kCapacity] = {};
            if (own_entry == next_entry) {
                --count;
                const Splat& splat = view.entries.splats[rank];
                const PixelCoverage coverage = pixel_coverage(splat, pixel.x, pixel.y);
                const float transmittance_before = transmittances[count],
                            weight = transmittance_before * coverage.alpha;
                const float* feature = features + static_cast<std::size_t>(view.entries.indices[rank]) * channels;
                float value = per_weight * (splat.z - depth.nearest - mean_behind);
                for (int c = 0; c < kCapacity; ++c) {
                    if (c < channels) value += upstream.colour[c] * feature[c];
                    parts[5 + c] = weight * upstream.colour[c];
                }
                const float step = value - behind;
                const float grad_alpha = transmittance_before * (step + upstream.alpha * transmittance_behind);
                behind += coverage.alpha * step;
                transmittance_behind *= 1.0f - coverage.alpha;
                parts[0] = grad_alpha * coverage.dx;
                parts[1] = grad_alpha * coverage.dy;
                parts[2] = grad_alpha * coverage.square;
                parts[3] = grad_alpha * coverage.falloff;
                parts[4] = weight * per_weight;
            }
            add(rank, parts, lane);
        }
    }

  private:
    FOURD_DEVICE void add(std::size_t rank, const float* parts, const device::Lane& lane) const {
        float* to = view.entries.sums + rank * static_cast<std::size_t>(5 + channels);
        for (int k = 0; k < 5 + kCapacity; ++k) {
            if (k >= 5 + channels) break;
            const float total = lane.sum(parts[k]);
            if (lane.is_first()) device::atomic_add(to + k, total);
        }
    }
};

// Computes the gradient of a point from gradients that were summed over pixels. Sums are indexed by rank, which is the
// position of the point in depth order. Culled points get zero gradients.
struct GradientPoint {
    Entries entries;
    Pinhole camera;
    const float* density;
    int channels;
    CloudGradient out;

    FOURD_DEVICE void operator()(std::size_t rank) const {
        const std::size_t point = entries.indices[rank];
        const float* sums = entries.sums + rank * static_cast<std::size_t>(5 + channels);
        for (int c = 0; c < channels; ++c) out.features[point * channels + c] = sums[5 + c];
        if (entries.depths[rank] == kCulled) {
            for (int axis = 0; axis < 3; ++axis) out.xyz[3 * point + axis] = 0.0f;
            out.radius[point] = 0.0f;
            out.density[point] = 0.0f;
            return;
        }
        const SplatGradient gradient = {sums[0], sums[1], sums[2], sums[3], sums[4]};
        project_backward(camera, entries.splats[rank], gradient, density[point], out.xyz + 3 * point,
                         out.radius + point, out.density + point);
    }
};

}  // namespace fourd::points::cuda
