// Kernels that project triangles and render images. Each pixel of a tile has one thread (tiles/cuda/traversal.h), even
// if the pixel is outside the image.
#pragma once

#include <cstring>

#include "soft_triangles/cuda/render.h"
#include "tiles/cuda/traversal.h"

namespace fourd::soft_triangles::cuda {

using Entries = tiles::cuda::Entries<Face>;
using tiles::cuda::EntryList;
using tiles::cuda::Pixel;

struct ProjectTriangle {
    Mesh mesh;
    Settings settings;
    Entries to;

    FOURD_DEVICE void operator()(std::size_t triangle) const {
        const auto at = project(settings.camera, settings.near_depth, settings.softness,
                                corners_of(settings.camera, mesh.xyz, mesh.tri + 3 * triangle));
        Face face{};
        if (at.visible) {
            face.x = at.x;
            face.y = at.y;
            for (int k = 0; k < 3; ++k) {
                face.u[k] = at.u[k];
                face.v[k] = at.v[k];
                face.inverse_z[k] = at.inverse_z[k];
                face.inverse_square[k] = at.inverse_square[k];
            }
            face.inverse_area = at.inverse_area;
            face.range = {static_cast<std::uint16_t>(at.left), static_cast<std::uint16_t>(at.right),
                          static_cast<std::uint16_t>(at.top), static_cast<std::uint16_t>(at.bottom)};
        }
        to.by_index[triangle] = face;
        // All visible triangles have the same sort key, so the stable sort keeps them in index order.
        to.keys[triangle] = at.visible ? 0u : tiles::cuda::kCulled;
        to.values[triangle] = static_cast<std::uint32_t>(triangle);
    }
};

// The inputs that all kernels with one thread per pixel have in common.
struct View {
    Entries entries;
    Softness softness;
    int width, height, layers;
    const float* features;  // Indexed by triangle.
    int channels;

    FOURD_DEVICE Pixel pixel(std::size_t index) const {
        return tiles::cuda::pixel_of(index, entries.tiles, width, height);
    }

    FOURD_DEVICE auto coverage(std::size_t rank, const Pixel& pixel) const {
        return coverage_at(entries.splats[rank], softness, pixel.x, pixel.y);
    }

    FOURD_DEVICE const float* features_of(std::size_t rank) const {
        return features + static_cast<std::size_t>(entries.indices[rank]) * channels;
    }
};

// Selects the nearest triangles of a pixel, at most `layers` of them: all triangles in front of the depth `last`, and
// the first `ties` triangles at the depth `last`.
struct Nearest {
    float depth;  // The smallest depth of the triangles and the background.
    float last;
    int ties;

    // Returns true if the pixel uses a triangle at the depth hit_depth. Call this function for the triangles in index
    // order.
    FOURD_DEVICE bool takes(float hit_depth) {
        if (!(hit_depth < kNoHit)) return false;
        if (hit_depth < last) return true;
        return hit_depth == last && ties-- > 0;
    }
};

// Returns how many triangles of the list have a depth of at most `depth` at the pixel.
FOURD_DEVICE static inline int count_up_to(const View& view, const EntryList& list, const Pixel& pixel, float depth) {
    int found = 0;
    for (std::size_t position = 0; position < list.count; ++position) {
        found += view.coverage(list.rank(position), pixel).depth <= depth ? 1 : 0;
    }
    return found;
}

FOURD_DEVICE static inline float float_of(std::uint32_t bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

// Returns which triangles are used at a pixel, as a struct Nearest. If at most `layers` triangles hit the pixel, all of
// them are used. Otherwise, a binary search finds the depth of the last triangle that is used. The search runs over the
// bits of the depths, read as integers. Depths are positive, so their bits have the same order as the depths.
FOURD_DEVICE static inline Nearest find_nearest(const View& view, const EntryList& list, const Pixel& pixel) {
    Nearest out{view.softness.background_depth, kNoHit, 0};
    int hits = 0;
    for (std::size_t position = 0; position < list.count; ++position) {
        const float depth = view.coverage(list.rank(position), pixel).depth;
        hits += depth < kNoHit ? 1 : 0;
        out.depth = minimum(depth, out.depth);
    }
    if (hits <= view.layers) return out;
    std::uint32_t low = 0, high = 0x7f7fffffu;
    while (low + 1 < high) {
        const std::uint32_t middle = low + (high - low) / 2;
        if (count_up_to(view, list, pixel, float_of(middle)) >= view.layers) {
            high = middle;
        } else {
            low = middle;
        }
    }
    out.last = float_of(high);
    out.ties = view.layers - count_up_to(view, list, pixel, float_of(high - 1));
    return out;
}

template <int kCapacity>
struct RenderPixel {
    View view;
    Image out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Pixel pixel = view.pixel(index);
        if (!pixel.inside) return;
        const EntryList list = tiles::cuda::entry_list(view.entries, pixel.tile);
        Nearest nearest = find_nearest(view, list, pixel);
        float colour[kCapacity] = {}, open = 1.0f;
        float total = depth_weight(view.softness, nearest.depth, view.softness.background_depth);
        for (std::size_t position = 0; position < list.count; ++position) {
            const std::size_t rank = list.rank(position);
            const auto at = view.coverage(rank, pixel);
            if (!nearest.takes(at.depth)) continue;
            const Odds<float> odds = odds_of(at.x);
            const float weight = odds.covered * depth_weight(view.softness, nearest.depth, at.depth);
            const float* feature = view.features_of(rank);
            open *= odds.open;
            total += weight;
            for (int c = 0; c < kCapacity; ++c) {
                if (c < view.channels) colour[c] += weight * feature[c];
            }
        }
        out.alpha[pixel.index] = 1.0f - open;
        for (int c = 0; c < kCapacity; ++c) {
            if (c < view.channels) out.features[pixel.index * view.channels + c] = colour[c] / total;
        }
    }
};

}  // namespace fourd::soft_triangles::cuda
