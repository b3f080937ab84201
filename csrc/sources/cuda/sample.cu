#include "sources/cuda/sample.h"

#include <cmath>

#include "device/clear.h"
#include "device/machine.h"

namespace fourd::sources::cuda {
namespace {

// Kernels over a query's views and points, point by point within a view.
struct Views {
    Maps maps;
    Pinhole cameras[kMostViews];
    const float* xyz;
    std::size_t count;
    float softness;

    explicit Views(const Query& query)
        : maps(query.maps), cameras{}, xyz(query.xyz), count(query.count), softness(query.softness) {
        for (int view = 0; view < query.views; ++view) cameras[view] = query.cameras[view];
    }

    FOURD_DEVICE Around in_image(const Projected& at) const {
        return around(at.u - 0.5f, at.v - 0.5f, maps.width, maps.height);
    }

    FOURD_DEVICE Around in_features(const Projected& at) const {
        const float across = static_cast<float>(maps.feature_width) / static_cast<float>(maps.width);
        const float down = static_cast<float>(maps.feature_height) / static_cast<float>(maps.height);
        return around(at.u * across - 0.5f, at.v * down - 0.5f, maps.feature_width, maps.feature_height);
    }

    FOURD_DEVICE std::size_t image_size() const { return static_cast<std::size_t>(maps.width) * maps.height; }
    FOURD_DEVICE std::size_t feature_size() const {
        return static_cast<std::size_t>(maps.feature_width) * maps.feature_height;
    }
};

FOURD_DEVICE static inline int nearest(float place, int size) {
    const float last = static_cast<float>(size - 1);
    place = place > 0.0f ? place : 0.0f;
    return static_cast<int>(std::rint(place < last ? place : last));
}

struct Sample {
    Views views;
    Samples out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const std::size_t view = index / views.count, point = index % views.count;
        const Maps& maps = views.maps;
        const Projected at = project(views.cameras[view], views.xyz + 3 * point);
        float* to = out.channels + view * static_cast<std::size_t>(maps.channels + 3) * views.count + point;
        const Around feature = views.in_features(at);
        for (int c = 0; c < maps.channels; ++c) {
            to[c * views.count] = sample(maps.features + (view * maps.channels + c) * views.feature_size(), feature);
        }
        const Around image = views.in_image(at);
        for (int c = 0; c < 3; ++c) {
            to[(maps.channels + c) * views.count] = sample(maps.images + (view * 3 + c) * views.image_size(), image);
        }
        out.trust[index] = trust(view, at, image);
    }

    // A pixel on the silhouette mixes in background, so that trust falls faster than coverage does.
    FOURD_DEVICE float trust(std::size_t view, const Projected& at, const Around& image) const {
        if (!(at.z > 0.0f)) return 0.0f;
        const Maps& maps = views.maps;
        const float matte = sample(maps.mattes + view * views.image_size(), image);
        if (!maps.depth) return matte * matte;
        const std::size_t row = nearest(at.v - 0.5f, maps.height), column = nearest(at.u - 0.5f, maps.width);
        const float surface = maps.depth[view * views.image_size() + row * maps.width + column];
        const float behind = at.z - surface - 2.0f * views.softness;
        return matte * matte * std::exp(behind > 0.0f ? -behind / views.softness : 0.0f);
    }
};

struct SampleBackward {
    Views views;
    const float* gradient;
    Gradients out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const std::size_t view = index / views.count, point = index % views.count;
        const Maps& maps = views.maps;
        const Projected at = project(views.cameras[view], views.xyz + 3 * point);
        const float* from = gradient + view * static_cast<std::size_t>(maps.channels + 3) * views.count + point;
        float grad_u = 0.0f, grad_v = 0.0f;
        const Around feature = views.in_features(at);
        for (int c = 0; c < maps.channels; ++c) {
            const std::size_t map = (view * maps.channels + c) * views.feature_size();
            const float g = from[c * views.count];
            move(maps.features + map, feature, g, &grad_u, &grad_v);
            if (out.features) spread(out.features + map, feature, g);
        }
        grad_u *= static_cast<float>(maps.feature_width) / static_cast<float>(maps.width);
        grad_v *= static_cast<float>(maps.feature_height) / static_cast<float>(maps.height);
        const Around image = views.in_image(at);
        for (int c = 0; c < 3; ++c) {
            move(maps.images + (view * 3 + c) * views.image_size(), image, from[(maps.channels + c) * views.count],
                 &grad_u, &grad_v);
        }
        float grad_xyz[3] = {};
        project_backward(views.cameras[view], at, grad_u, grad_v, grad_xyz);
        for (int axis = 0; axis < 3; ++axis) device::add_shared(out.xyz + 3 * point + axis, grad_xyz[axis]);
    }

    FOURD_DEVICE static void move(const float* map, const Around& at, float g, float* grad_u, float* grad_v) {
        for (int corner = 0; corner < 4; ++corner) {
            const float value = map[at.offset[corner]];
            if (at.across[corner] != 0.0f) *grad_u += g * at.across[corner] * value;
            if (at.down[corner] != 0.0f) *grad_v += g * at.down[corner] * value;
        }
    }

    FOURD_DEVICE static void spread(float* map, const Around& at, float g) {
        for (int corner = 0; corner < 4; ++corner) {
            if (at.weight[corner] != 0.0f) device::add_shared(map + at.offset[corner], g * at.weight[corner]);
        }
    }
};

}  // namespace

void sample(const Query& query, const Samples& out, void* stream) {
    device::Machine(stream).each(query.count * query.views, Sample{Views(query), out});
}

void sample_backward(const Query& query, const float* gradient, const Gradients& out, void* stream) {
    const device::Machine machine(stream);
    const Maps& maps = query.maps;
    machine.each(3 * query.count, device::Clear{out.xyz});
    if (out.features) {
        const std::size_t size = static_cast<std::size_t>(maps.feature_width) * maps.feature_height;
        machine.each(size * maps.channels * query.views, device::Clear{out.features});
    }
    machine.each(query.count * query.views, SampleBackward{Views(query), gradient, out});
}

}  // namespace fourd::sources::cuda
