// Computes the backward pass of an image with two kernels: one over pixels, then one over triangles.
#pragma once

#include "soft_triangles/cuda/picture.h"

namespace fourd::soft_triangles::cuda {

template <int kCapacity>
struct GradientPixel {
    View view;
    ImageGradient gradient;

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const Pixel pixel = view.pixel(index);
        const EntryList list = tiles::cuda::entry_list(view.entries, pixel.tile);
        float upstream[kCapacity] = {}, upstream_alpha = 0.0f;
        if (pixel.inside) {
            upstream_alpha = gradient.alpha[pixel.index];
            for (int c = 0; c < kCapacity; ++c) {
                if (c < view.channels) upstream[c] = gradient.features[pixel.index * view.channels + c];
            }
        }
        const Nearest found = find_nearest(view, list, pixel);
        const Sums sums = sum(list, pixel, found, upstream);
        Nearest nearest = found;
        for (std::size_t position = 0; position < list.count; ++position) {
            const std::size_t rank = list.rank(position);
            const auto at = view.coverage(rank, pixel);
            const bool taken = nearest.takes(at.depth) && pixel.inside;
            if (!lane.any(taken)) continue;
            // The members of ShapeGradient, followed by the gradients of the channels.
            float parts[kShapeSums + kCapacity] = {};
            if (taken) {
                const Odds<float> odds = odds_of(at.x);
                const float share =
                    odds.covered * depth_weight(view.softness, nearest.depth, at.depth) / sums.weight;
                const float to_logarithm = share * (value_of(rank, upstream) - sums.mean);
                const float to_x = to_logarithm * odds.open + upstream_alpha * sums.open * odds.covered;
                add_gradient(view.entries.splats[rank], view.softness, pixel.x, pixel.y, at, to_x,
                             -to_logarithm * view.softness.per_depth, parts);
                for (int c = 0; c < kCapacity; ++c) parts[kShapeSums + c] = share * upstream[c];
            }
            add(rank, parts, lane);
        }
    }

  private:
    struct Sums {
        float open;    // Product of 1 - D (maths.h) over the triangles of the pixel.
        float weight;  // Sum of the weights, including the weight of the background.
        // Weighted mean of value_of() over the triangles of the pixel and the background, which has the value 0.
        float mean;
    };

    // Returns the dot product of a triangle's features and `upstream`, the gradient of the loss with respect to the
    // features of the pixel.
    FOURD_DEVICE float value_of(std::size_t rank, const float* upstream) const {
        const float* feature = view.features_of(rank);
        float value = 0.0f;
        for (int c = 0; c < kCapacity; ++c) {
            if (c < view.channels) value += upstream[c] * feature[c];
        }
        return value;
    }

    FOURD_DEVICE Sums sum(const EntryList& list, const Pixel& pixel, Nearest nearest, const float* upstream) const {
        Sums out{1.0f, depth_weight(view.softness, nearest.depth, view.softness.background_depth), 0.0f};
        for (std::size_t position = 0; position < list.count; ++position) {
            const std::size_t rank = list.rank(position);
            const auto at = view.coverage(rank, pixel);
            if (!nearest.takes(at.depth)) continue;
            const Odds<float> odds = odds_of(at.x);
            const float weight = odds.covered * depth_weight(view.softness, nearest.depth, at.depth);
            out.open *= odds.open;
            out.weight += weight;
            out.mean += weight * value_of(rank, upstream);
        }
        out.mean /= out.weight;
        return out;
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

// Computes the gradient of a triangle from gradients that were summed over pixels. Sums are indexed by rank, the
// position in a sorted list of all triangles: visible triangles come first, in index order, and culled triangles come
// last. Culled triangles get zero gradients.
struct GradientTriangle {
    Entries entries;
    Mesh mesh;
    Pinhole camera;
    MeshGradient out;

    FOURD_DEVICE void operator()(std::size_t rank) const {
        const std::size_t triangle = entries.indices[rank], channels = static_cast<std::size_t>(mesh.channels);
        const float* sums = entries.sums + rank * (kShapeSums + channels);
        for (std::size_t c = 0; c < channels; ++c) out.features[triangle * channels + c] = sums[kShapeSums + c];
        if (entries.depths[rank] == tiles::cuda::kCulled) return;
        ShapeGradient shape;
        memcpy(&shape, sums, sizeof shape);
        float corners[9];
        const std::int32_t* tri = mesh.tri + 3 * triangle;
        project_backward(camera, corners_of(camera, mesh.xyz, tri), shape, corners);
        for (int corner = 0; corner < 3; ++corner) {
            float* to = out.xyz + 3 * static_cast<std::size_t>(tri[corner]);
            for (int axis = 0; axis < 3; ++axis) device::atomic_add(to + axis, corners[3 * corner + axis]);
        }
    }
};

}  // namespace fourd::soft_triangles::cuda
