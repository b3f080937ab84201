// Computes the backward pass of an image with two kernels: one over pixels, then one over triangles.
#pragma once

#include "splat_triangles/cuda/picture.h"

namespace fourd::splat_triangles::cuda {

// `channel` is the gradient of the loss with respect to the composited channels of a pixel. `rest` is needed for the
// gradients with respect to the alphas of the triangles (rest_k in splat_triangles/cpu/gradient.inc). Let w_j be the
// compositing weight of triangle j, v_j the dot product of its channels and `channel`, g the gradient with respect to
// the pixel's alpha, and T_end the final transmittance. Then
//     rest = (sum of w_j * v_j over the triangles behind the current one) - g * T_end.
// The constructor computes `rest` in front of the first triangle, where the sum contains all triangles.
template <int kCapacity>
struct Upstream {
    float channel[kCapacity];
    float rest;

    FOURD_DEVICE Upstream(const View& view, const ImageGradient& gradient, const Pixel& pixel) : rest(0.0f) {
        for (int c = 0; c < kCapacity; ++c) channel[c] = 0.0f;
        if (!pixel.inside) return;
        const Image& rendered = gradient.rendered;
        float alpha = gradient.alpha[pixel.index];
        const float opacity = rendered.alpha[pixel.index];
        for (int c = 0; c < kCapacity; ++c) {
            if (c < view.features) {
                const std::size_t at = pixel.index * view.features + c;
                channel[c] = gradient.features[at];
                rest += channel[c] * rendered.features[at];
            } else if (c < view.features + 3 && view.geometry) {
                const std::size_t at = 3 * pixel.index + c - view.features;
                channel[c] = gradient.normal[at];
                rest += channel[c] * rendered.normal[at];
            } else if (c < view.channels) {
                channel[c] = opacity > 0.0f ? gradient.depth[pixel.index] / opacity : 0.0f;
                const float through_alpha = channel[c] * rendered.depth[pixel.index];
                rest += through_alpha * opacity;
                alpha -= through_alpha;
            }
        }
        rest -= alpha * rendered.transmittance[pixel.index];
    }
};

template <int kCapacity>
struct GradientPixel {
    View view;
    ImageGradient gradient;

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const Pixel pixel = view.pixel(index);
        const tiles::cuda::EntryList list = tiles::cuda::entry_list(view.entries, pixel.tile);
        const Upstream<kCapacity> upstream(view, gradient, pixel);
        float transmittance = 1.0f, rest = upstream.rest;
        int layers_left = pixel.inside ? view.layers : 0;
        for (std::size_t position = 0; position < list.count; ++position) {
            const bool open = layers_left > 0 && transmittance > kMinTransmittance;
            if (!lane.any(open)) break;
            const std::size_t rank = list.rank(position);
            const Splat& splat = view.entries.splats[rank];
            const PixelCoverage coverage = pixel_coverage(splat, pixel.x, pixel.y);
            const bool hit = open && coverage.alpha > 0.0f;
            if (!lane.any(hit)) continue;
            // The members of ShapeGradient, followed by the gradients of the channels.
            float parts[kShapeSums + kCapacity] = {};
            if (hit) {
                const float weight = transmittance * coverage.alpha;
                const float* feature = view.values_of(rank);
                float value = 0.0f;
                for (int c = 0; c < kCapacity; ++c) {
                    if (c < view.channels) value += upstream.channel[c] * feature[c];
                    parts[kShapeSums + c] = weight * upstream.channel[c];
                }
                rest -= weight * value;
                const float to_alpha = transmittance * value - rest / (1.0f - coverage.alpha);
                if (coverage.unclamped <= kMaxAlpha) shape_parts(splat, coverage, to_alpha, parts);
                transmittance = transmittance * (1.0f - coverage.alpha);
                --layers_left;
            }
            add(rank, parts, lane);
        }
    }

  private:
    FOURD_DEVICE static void shape_parts(const Splat& splat, const PixelCoverage& coverage, float to_alpha,
                                         float* parts) {
        const Window& window = coverage.window;
        const float scaled = to_alpha * coverage.unclamped;
        const float to_window = scaled * splat.sigma / window.smallest;
        for (int k = 0; k < 3; ++k) {
            const float to_edge = k == window.edge ? to_window : 0.0f;
            parts[k] = to_edge;
            parts[3 + k] = to_edge * window.dx;
            parts[6 + k] = to_edge * window.dy;
        }
        parts[9] = to_alpha * coverage.falloff;
        parts[10] = scaled * log2_of(window.smallest) * kLn2;
    }

    FOURD_DEVICE void add(std::size_t rank, const float* parts, const device::Lane& lane) const {
        float* to = view.entries.sums + rank * static_cast<std::size_t>(kShapeSums + view.channels);
        for (int k = 0; k < kShapeSums + kCapacity; ++k) {
            if (k >= kShapeSums + view.channels) break;
            const float total = lane.sum(parts[k]);
            if (lane.is_first()) device::atomic_add(to + k, total);
        }
    }
};

// Computes the gradient of a triangle from gradients that were summed over pixels. Sums are indexed by rank, which is
// the position of the triangle in depth order. Culled triangles get zero gradients.
struct GradientTriangle {
    Entries entries;
    Mesh mesh;
    tiles::Pinhole camera;
    MeshGradient out;

    FOURD_DEVICE void operator()(std::size_t rank) const {
        const std::size_t triangle = entries.indices[rank], channels = static_cast<std::size_t>(mesh.channels);
        const float* sums = entries.sums + rank * (kShapeSums + channels);
        for (std::size_t c = 0; c < channels; ++c) out.features[triangle * channels + c] = sums[kShapeSums + c];
        const bool visible = entries.depths[rank] != tiles::cuda::kCulled;
        ShapeGradient shape{};
        if (visible) memcpy(&shape, sums, sizeof shape);
        out.opacity[triangle] = shape.opacity;
        out.sigma[triangle] = shape.sigma;
        if (!visible) return;
        float corners[9];
        const std::int32_t* tri = mesh.tri + 3 * triangle;
        project_backward(camera, corners_of(camera, mesh.xyz, tri), entries.splats[rank], shape, corners);
        for (int corner = 0; corner < 3; ++corner) {
            float* to = out.xyz + 3 * static_cast<std::size_t>(tri[corner]);
            for (int axis = 0; axis < 3; ++axis) device::atomic_add(to + axis, corners[3 * corner + axis]);
        }
    }
};

}  // namespace fourd::splat_triangles::cuda
