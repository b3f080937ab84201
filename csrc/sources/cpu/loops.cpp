// Samples one view at batches of points, and computes the gradient of the samples. The loops are written so that
// compilers vectorise them.
#include "sources/cpu/loops.h"

#include "common/eight.h"
#include "common/inline.h"

namespace fourd::sources::FOURD_SIMD {
namespace {

constexpr int kMaxChannels = 256;

FOURD_INLINE std::size_t image_size(const Maps& maps) { return static_cast<std::size_t>(maps.width) * maps.height; }

// The template argument Channels is the number of channels if it is known at compile time, and 0 otherwise. If it is
// known, the compiler can divide the loops into whole vectors.
template <int Channels>
FOURD_INLINE int channels_of(const Maps& maps) {
    return Channels > 0 ? Channels : maps.channels;
}

// Interpolates channel c. If Number is Eight, the function also interpolates the next seven channels.
template <typename Number>
FOURD_INLINE void gather_at(const float* features, const Bilinear& at, int channels, std::size_t c, float* out) {
    Number sum{};
    for (int corner = 0; corner < 4; ++corner) {
        Number value;
        load(features + at.offset[corner] * channels + c, &value);
        sum += at.weight[corner] * value;
    }
    store(&sum, out + c);
}

// Samples one view at the points [first, first + count).
template <int Channels>
FOURD_INLINE void sample_run(const Query& query, std::size_t view, std::size_t first, int count, const Samples& out) {
    const Maps& maps = query.maps;
    const int channels = channels_of<Channels>(maps);
    float rows[kRun * (Channels > 0 ? Channels : kMaxChannels)];
    const float* features = maps.features + view * feature_size(maps);
    float* to = out.channels + view * static_cast<std::size_t>(channels + 3) * query.count + first;
    for (int i = 0; i < count; ++i) {
        const Projection at = project(query.cameras[view], query.xyz + 3 * (first + i));
        const Bilinear feature = bilinear_in_features(maps, at);
        for_eights(channels, [&](std::size_t c, auto* number) FOURD_INLINE_LAMBDA {
            gather_at<NumberOf<decltype(number)>>(features, feature, channels, c, rows + i * channels);
        });
        const Bilinear image = bilinear_in_image(maps, at);
        for (int c = 0; c < 3; ++c) {
            const float* map = maps.images + (view * 3 + c) * image_size(maps);
            to[static_cast<std::size_t>(channels + c) * query.count + i] = sample(map, image);
        }
        out.visibility[view * query.count + first + i] = visibility(maps, view, at, image, query.softness[first + i]);
    }
    for (int c = 0; c < channels; ++c) {
        for (int i = 0; i < count; ++i) to[static_cast<std::size_t>(c) * query.count + i] = rows[i * channels + c];
    }
}

FOURD_INLINE float total(const float* number) { return *number; }
#if defined(FOURD_EIGHT)
FOURD_INLINE float total(const Eight* number) {
    const Eight& of = *number;
    return ((of[0] + of[4]) + (of[1] + of[5])) + ((of[2] + of[6]) + (of[3] + of[7]));
}
#endif

// Back-propagates the gradient of channel c and, if Number is Eight, of the next seven channels. Adds the gradient with
// respect to the pixel position to `sum`, and the gradient with respect to the features to `to`, which may be null.
template <typename Number>
FOURD_INLINE void scatter_at(const float* features, const Bilinear& at, int channels, std::size_t c,
                             const float* gradient, float* to, PixelGradient* sum) {
    Number g, grad_x{}, grad_y{};
    load(gradient + c, &g);
    for (int corner = 0; corner < 4; ++corner) {
        const std::size_t offset = at.offset[corner] * channels + c;
        Number value;
        load(features + offset, &value);
        grad_x += at.slope_x[corner] * value;
        grad_y += at.slope_y[corner] * value;
        if (!to) continue;
        Number updated;
        load(to + offset, &updated);
        updated += at.weight[corner] * g;
        store(&updated, to + offset);
    }
    grad_x *= g;
    grad_y *= g;
    sum->u += total(&grad_x);
    sum->v += total(&grad_y);
}

template <int Channels>
FOURD_INLINE void backward_run(const Query& query, const float* gradient, std::size_t view, std::size_t first,
                               int count, float* to_features, float* to_xyz) {
    const Maps& maps = query.maps;
    const int channels = channels_of<Channels>(maps);
    float rows[kRun * (Channels > 0 ? Channels : kMaxChannels)];
    const float* from = gradient + view * static_cast<std::size_t>(channels + 3) * query.count + first;
    for (int c = 0; c < channels; ++c) {
        for (int i = 0; i < count; ++i) rows[i * channels + c] = from[static_cast<std::size_t>(c) * query.count + i];
    }
    const float* features = maps.features + view * feature_size(maps);
    const float scale_x = feature_scale_x(maps), scale_y = feature_scale_y(maps);
    for (int i = 0; i < count; ++i) {
        const Projection at = project(query.cameras[view], query.xyz + 3 * (first + i));
        PixelGradient by_features = {0.0f, 0.0f}, by_image = {0.0f, 0.0f};
        const Bilinear feature = bilinear_in_features(maps, at);
        for_eights(channels, [&](std::size_t c, auto* number) FOURD_INLINE_LAMBDA {
            scatter_at<NumberOf<decltype(number)>>(features, feature, channels, c, rows + i * channels, to_features,
                                                   &by_features);
        });
        const Bilinear image = bilinear_in_image(maps, at);
        for (int c = 0; c < 3; ++c) {
            const float* map = maps.images + (view * 3 + c) * image_size(maps);
            const float g = from[static_cast<std::size_t>(channels + c) * query.count + i];
            for (int corner = 0; corner < 4; ++corner)
                add_pixel_gradient(by_image, image, corner, g * map[image.offset[corner]]);
        }
        const float grad_u = by_image.u + scale_x * by_features.u, grad_v = by_image.v + scale_y * by_features.v;
        project_backward(query.cameras[view], at, grad_u, grad_v, to_xyz + 3 * (first + i));
    }
}

template <int Channels>
void sample(const Query& query, std::size_t view, std::size_t first, int count, const Samples& out) {
    sample_run<Channels>(query, view, first, count, out);
}

template <int Channels>
void backward(const Query& query, const float* gradient, std::size_t view, std::size_t first, int count,
              float* to_features, float* to_xyz) {
    backward_run<Channels>(query, gradient, view, first, count, to_features, to_xyz);
}

}  // namespace

const Loops loops = {{sample<16>, backward<16>}, {sample<0>, backward<0>}};

}  // namespace fourd::sources::FOURD_SIMD
