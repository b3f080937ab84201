// The gradient of a picture: pixels first, then points.
#pragma once

#include "points/cuda/picture.h"

namespace fourd::points::cuda {

// The image's gradient at a pixel. A layer has value = features . colour + per_weight * (z - nearest - behind), and
// the image is the composite of these values. Alpha has its own term: as one more value it would be what is
// left of nearly 1 - 1 where much is opaque.
template <int kRoom>
struct Upstream {
    float colour[kRoom];
    float alpha, depth;

    FOURD_DEVICE Upstream(const ImageGradient& gradient, const Pixel& pixel, int channels) {
        for (int c = 0; c < kRoom; ++c) {
            colour[c] = pixel.inside && c < channels ? gradient.features[pixel.place * channels + c] : 0.0f;
        }
        alpha = pixel.inside ? gradient.alpha[pixel.place] : 0.0f;
        depth = pixel.inside && gradient.depth ? gradient.depth[pixel.place] : 0.0f;
    }
};

// A pixel goes forward and remembers what it composites, then comes back; the way back is shared by the warp,
// which stops wherever one of its pixels has something to add.
template <int kRoom, int kLayers>
struct GradientPixel {
    View view;              // layers is at most kLayers
    const float* features;  // by point
    int channels;
    ImageGradient gradient;

    FOURD_DEVICE void operator()(std::size_t index, const device::Lane& lane) const {
        const Pixel pixel = view.pixel(index);
        const Row row = row_of(view.entries, pixel.tile);
        std::uint32_t places[kLayers];
        float transmittances[kLayers];
        int left = 0;
        DepthSum depth;
        // A transmittance of exactly 0 ends no pixel here: what lies behind a point of alpha 1 is the
        // gradient of that alpha.
        const float transmittance =
            walk(view.entries, row, pixel, view.layers, -1.0f, lane,
                 [&](std::size_t place, std::size_t, const Splat& splat, const PixelTouch& at, float passed) {
                     places[left] = static_cast<std::uint32_t>(place);
                     transmittances[left] = passed;
                     ++left;
                     depth.add(splat.z, passed * at.alpha);
                 });
        const bool seen = 1.0f - transmittance > 0.0f;
        const Upstream<kRoom> upstream(gradient, pixel, channels);
        const float per_weight = seen ? upstream.depth / depth.weight : 0.0f;
        const float mean_behind = seen ? depth.mean_behind() : 0.0f;
        float behind = 0.0f;   // the composite value of what lies behind
        float through = 1.0f;  // and the light that it lets through
        while (true) {
            const std::uint32_t own = left > 0 ? places[left - 1] + 1 : 0;
            const std::uint32_t next = lane.largest(own);
            if (next == 0) break;
            const std::size_t rank = row.rank(next - 1);
            float parts[5 + kRoom] = {};  // SplatGradient, and the features'
            if (own == next) {
                --left;
                const Splat& splat = view.entries.splats[rank];
                const PixelTouch at = touch_pixel(splat, pixel.x, pixel.y);
                const float passed = transmittances[left], weight = passed * at.alpha;
                const float* feature = features + static_cast<std::size_t>(view.entries.points[rank]) * channels;
                float value = per_weight * (splat.z - depth.nearest - mean_behind);
                for (int c = 0; c < kRoom; ++c) {
                    if (c < channels) value += upstream.colour[c] * feature[c];
                    parts[5 + c] = weight * upstream.colour[c];
                }
                const float step = value - behind;
                const float grad_alpha = passed * (step + upstream.alpha * through);
                behind += at.alpha * step;
                through *= 1.0f - at.alpha;
                parts[0] = grad_alpha * at.dx;
                parts[1] = grad_alpha * at.dy;
                parts[2] = grad_alpha * at.square;
                parts[3] = grad_alpha * at.falloff;
                parts[4] = weight * per_weight;
            }
            add(rank, parts, lane);
        }
    }

  private:
    FOURD_DEVICE void add(std::size_t rank, const float* parts, const device::Lane& lane) const {
        float* to = view.entries.sums + rank * static_cast<std::size_t>(5 + channels);
        for (int k = 0; k < 5 + kRoom; ++k) {
            if (k >= 5 + channels) break;
            const float total = lane.sum(parts[k]);
            if (lane.first()) device::add_shared(to + k, total);
        }
    }
};

// Carries the sums of a rank to its point; culled points get zeros.
struct GradientPoint {
    Entries entries;
    Pinhole camera;
    const float* density;
    int channels;
    CloudGradient out;

    FOURD_DEVICE void operator()(std::size_t rank) const {
        const std::size_t point = entries.points[rank];
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
