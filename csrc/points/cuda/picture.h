// Pictures, and what each point adds to them. Kernels over the pixels of whole tiles, see walk.h.
#pragma once

#include "points/cuda/walk.h"

namespace fourd::points::cuda {

// What a kernel over pixels knows.
struct View {
    Entries entries;
    int width, height, layers;
    float transmittance_min;

    FOURD_DEVICE Pixel pixel(std::size_t index) const { return pixel_of(index, entries.tiles, width, height); }
};

// A pixel's depth from its layers' depths and weights. Depths are taken relative to the nearest, so that
// rounding errors are not magnified by small weights.
struct DepthSum {
    float nearest = -1.0f, weight = 0.0f, behind = 0.0f;

    FOURD_DEVICE void add(float z, float w) {
        if (nearest < 0.0f) nearest = z;
        weight += w;
        behind += w * (z - nearest);
    }

    // Where the pixel is seen: weights too small to show in alpha say nothing of depth.
    FOURD_DEVICE float mean_behind() const { return behind / weight; }
};

// kRoom: at least as many as channels, so that loops over them have no index known only at run time.
template <int kRoom>
struct RenderPixel {
    View view;
    const float* features;  // by point
    int channels;
    Image out;

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const Pixel pixel = view.pixel(index);
        float colour[kRoom] = {};
        DepthSum depth;
        const float transmittance = walk(
            view.entries, row_of(view.entries, pixel.tile), pixel, view.layers, view.transmittance_min, lane,
            [&](std::size_t, std::size_t rank, const Splat& splat, const PixelTouch& at, float passed) {
                const float weight = passed * at.alpha;
                const float* feature = features + static_cast<std::size_t>(view.entries.points[rank]) * channels;
                for (int c = 0; c < kRoom; ++c) {
                    if (c < channels) colour[c] += weight * feature[c];
                }
                depth.add(splat.z, weight);
            });
        if (!pixel.inside) return;
        const float alpha = 1.0f - transmittance;
        for (int c = 0; c < kRoom; ++c) {
            if (c < channels) out.features[pixel.place * channels + c] = colour[c];
        }
        out.alpha[pixel.place] = alpha;
        out.depth[pixel.place] = alpha > 0.0f ? depth.nearest + depth.mean_behind() : 0.0f;
    }
};

FOURD_DEVICE static inline std::uint8_t byte_of(float value) {
    value = value > 0.0f ? value : 0.0f;
    return static_cast<std::uint8_t>((value < 1.0f ? value : 1.0f) * 255.0f + 0.5f);
}

struct DrawPixel {
    View view;
    const float* features;  // three a point
    Canvas out;

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const Pixel pixel = view.pixel(index);
        float colour[3] = {};
        const float transmittance = walk(
            view.entries, row_of(view.entries, pixel.tile), pixel, view.layers, view.transmittance_min, lane,
            [&](std::size_t, std::size_t rank, const Splat&, const PixelTouch& at, float passed) {
                const float* feature = features + 3 * static_cast<std::size_t>(view.entries.points[rank]);
                for (int c = 0; c < 3; ++c) colour[c] += passed * at.alpha * feature[c];
            });
        if (!pixel.inside) return;
        std::uint8_t* to = out.rgba + 4 * pixel.place;
        for (int c = 0; c < 3; ++c) to[c] = byte_of(colour[c] + transmittance * out.background[c]);
        to[3] = byte_of(1.0f - transmittance);
    }
};

struct SeePixel {
    View view;
    float* out;  // by point, 0 before

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const Pixel pixel = view.pixel(index);
        walk(view.entries, row_of(view.entries, pixel.tile), pixel, view.layers, 0.0f, lane,
             [&](std::size_t, std::size_t rank, const Splat&, const PixelTouch& at, float passed) {
                 device::raise_shared(out + view.entries.points[rank], passed * at.alpha);
             });
    }
};

}  // namespace fourd::points::cuda
