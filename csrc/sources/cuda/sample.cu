#include "sources/cuda/sample.h"

#include "device/clear.h"
#include "device/executor.h"

namespace fourd::sources::cuda {
namespace {

// The views and points that a kernel processes. Consecutive threads process consecutive points of one view.
struct Views {
    Maps maps;
    Pinhole cameras[kMaxViews];
    const float* xyz;
    std::size_t count;
    const float* softness;

    explicit Views(const Query& query)
        : maps(query.maps), cameras{}, xyz(query.xyz), count(query.count), softness(query.softness) {
        for (int view = 0; view < query.views; ++view) cameras[view] = query.cameras[view];
    }

    FOURD_DEVICE std::size_t image_size() const { return static_cast<std::size_t>(maps.width) * maps.height; }

    // Returns the offset of a view's features in the array of all features.
    FOURD_DEVICE std::size_t features(std::size_t view) const {
        return view * maps.feature_width * static_cast<std::size_t>(maps.feature_height) * maps.channels;
    }

    // Returns the offset, in the array Samples::channels, of a point's first channel in one view. Consecutive channels
    // of the point are `count` floats apart.
    FOURD_DEVICE std::size_t channels(std::size_t view, std::size_t point) const {
        return view * static_cast<std::size_t>(maps.channels + 3) * count + point;
    }
};

struct Sample {
    Views views;
    Samples out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const std::size_t view = index / views.count, point = index % views.count;
        const Maps& maps = views.maps;
        const Projection at = project(views.cameras[view], views.xyz + 3 * point);
        float* to = out.channels + views.channels(view, point);
        const Bilinear feature = bilinear_in_features(maps, at);
        const float* from = maps.features + views.features(view);
        for (int c = 0; c < maps.channels; ++c) {
            float sum = 0.0f;
            for (int corner = 0; corner < 4; ++corner) {
                sum += feature.weight[corner] * from[feature.offset[corner] * maps.channels + c];
            }
            to[c * views.count] = sum;
        }
        const Bilinear image = bilinear_in_image(maps, at);
        for (int c = 0; c < 3; ++c) {
            to[(maps.channels + c) * views.count] = sample(maps.images + (view * 3 + c) * views.image_size(), image);
        }
        out.visibility[index] = visibility(maps, view, at, image, views.softness[point]);
    }
};

struct SampleBackward {
    Views views;
    const float* gradient;
    Gradients out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const std::size_t view = index / views.count, point = index % views.count;
        const Maps& maps = views.maps;
        const Projection at = project(views.cameras[view], views.xyz + 3 * point);
        const float* from = gradient + views.channels(view, point);
        PixelGradient by_features = {0.0f, 0.0f}, by_image = {0.0f, 0.0f};
        const Bilinear feature = bilinear_in_features(maps, at);
        for (int corner = 0; corner < 4 && maps.channels > 0; ++corner) {
            const std::size_t first = views.features(view) + feature.offset[corner] * maps.channels;
            for (int c = 0; c < maps.channels; ++c) {
                const float g = from[c * views.count];
                add_pixel_gradient(by_features, feature, corner, g * maps.features[first + c]);
                if (out.features && feature.weight[corner] != 0.0f) {
                    device::atomic_add(out.features + first + c, g * feature.weight[corner]);
                }
            }
        }
        const Bilinear image = bilinear_in_image(maps, at);
        for (int c = 0; c < 3; ++c) {
            const float* map = maps.images + (view * 3 + c) * views.image_size();
            const float g = from[(maps.channels + c) * views.count];
            for (int corner = 0; corner < 4; ++corner)
                add_pixel_gradient(by_image, image, corner, g * map[image.offset[corner]]);
        }
        const float grad_u = by_image.u + feature_scale_x(maps) * by_features.u;
        const float grad_v = by_image.v + feature_scale_y(maps) * by_features.v;
        float grad_xyz[3] = {};
        project_backward(views.cameras[view], at, grad_u, grad_v, grad_xyz);
        for (int axis = 0; axis < 3; ++axis) device::atomic_add(out.xyz + 3 * point + axis, grad_xyz[axis]);
    }
};

}  // namespace

void sample(const Query& query, const Samples& out, void* stream) {
    device::Executor(stream).for_each(query.count * query.views, Sample{Views(query), out});
}

void sample_backward(const Query& query, const float* gradient, const Gradients& out, void* stream) {
    const device::Executor executor(stream);
    const Maps& maps = query.maps;
    executor.for_each(3 * query.count, device::Clear{out.xyz});
    if (out.features) {
        const std::size_t size = static_cast<std::size_t>(maps.feature_width) * maps.feature_height;
        executor.for_each(size * maps.channels * query.views, device::Clear{out.features});
    }
    executor.for_each(query.count * query.views, SampleBackward{Views(query), gradient, out});
}

}  // namespace fourd::sources::cuda
