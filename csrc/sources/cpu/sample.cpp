#include <algorithm>
#include <vector>

#include "common/eight.h"
#include "common/inline.h"
#include "common/team.h"
#include "sources/sources.h"

namespace fourd::sources {
namespace {

constexpr int kRun = 64;  // points whose channels are turned from rows into columns in the first-level cache
constexpr int kMostChannels = 256;

std::size_t image_size(const Maps& maps) { return static_cast<std::size_t>(maps.width) * maps.height; }

std::size_t feature_size(const Maps& maps) {
    return static_cast<std::size_t>(maps.feature_width) * maps.feature_height * maps.channels;
}

// Channels is their number, or 0 for what the maps say: known, it makes loops that fit vectors.
template <int Channels>
FOURD_INLINE int channels_of(const Maps& maps) {
    return Channels > 0 ? Channels : maps.channels;
}

// The four samples' channels c and, for eight numbers, those after it, by weight.
template <typename Number>
FOURD_INLINE void gather_at(const float* features, const Around& at, int channels, std::size_t c, float* out) {
    Number sum{};
    for (int corner = 0; corner < 4; ++corner) {
        Number value;
        load(features + at.offset[corner] * channels + c, &value);
        sum += at.weight[corner] * value;
    }
    store(&sum, out + c);
}

// Points first to first + count of a view.
template <int Channels>
FOURD_INLINE void sample_run(const Query& query, std::size_t view, std::size_t first, int count, const Samples& out) {
    const Maps& maps = query.maps;
    const int channels = channels_of<Channels>(maps);
    float rows[kRun * (Channels > 0 ? Channels : kMostChannels)];
    const float* features = maps.features + view * feature_size(maps);
    float* to = out.channels + view * static_cast<std::size_t>(channels + 3) * query.count + first;
    for (int i = 0; i < count; ++i) {
        const Projected at = project(query.cameras[view], query.xyz + 3 * (first + i));
        const Around feature = around_in_features(maps, at);
        in_eights(channels, [&](std::size_t c, auto* number) FOURD_ALWAYS {
            gather_at<NumberOf<decltype(number)>>(features, feature, channels, c, rows + i * channels);
        });
        const Around image = around_in_image(maps, at);
        for (int c = 0; c < 3; ++c) {
            const float* map = maps.images + (view * 3 + c) * image_size(maps);
            to[static_cast<std::size_t>(channels + c) * query.count + i] = sample(map, image);
        }
        out.trust[view * query.count + first + i] = trust(maps, view, at, image, query.softness[first + i]);
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

// How channels c of the features around a point pull at its pixel; and, where they learn, their own gradient.
template <typename Number>
FOURD_INLINE void scatter_at(const float* features, const Around& at, int channels, std::size_t c, const float* gradient,
                             float* to, Pull* sum) {
    Number g, across{}, down{};
    load(gradient + c, &g);
    for (int corner = 0; corner < 4; ++corner) {
        const std::size_t offset = at.offset[corner] * channels + c;
        Number value;
        load(features + offset, &value);
        across += at.across[corner] * value;
        down += at.down[corner] * value;
        if (!to) continue;
        Number grown;
        load(to + offset, &grown);
        grown += at.weight[corner] * g;
        store(&grown, to + offset);
    }
    across *= g;
    down *= g;
    sum->u += total(&across);
    sum->v += total(&down);
}

template <int Channels>
FOURD_INLINE void backward_run(const Query& query, const float* gradient, std::size_t view, std::size_t first, int count,
                               float* to_features, float* to_xyz) {
    const Maps& maps = query.maps;
    const int channels = channels_of<Channels>(maps);
    float rows[kRun * (Channels > 0 ? Channels : kMostChannels)];
    const float* from = gradient + view * static_cast<std::size_t>(channels + 3) * query.count + first;
    for (int c = 0; c < channels; ++c) {
        for (int i = 0; i < count; ++i) rows[i * channels + c] = from[static_cast<std::size_t>(c) * query.count + i];
    }
    const float* features = maps.features + view * feature_size(maps);
    const float across = feature_scale_across(maps), down = feature_scale_down(maps);
    for (int i = 0; i < count; ++i) {
        const Projected at = project(query.cameras[view], query.xyz + 3 * (first + i));
        Pull by_features = {0.0f, 0.0f}, by_image = {0.0f, 0.0f};
        const Around feature = around_in_features(maps, at);
        in_eights(channels, [&](std::size_t c, auto* number) FOURD_ALWAYS {
            scatter_at<NumberOf<decltype(number)>>(features, feature, channels, c, rows + i * channels, to_features, &by_features);
        });
        const Around image = around_in_image(maps, at);
        for (int c = 0; c < 3; ++c) {
            const float* map = maps.images + (view * 3 + c) * image_size(maps);
            const float g = from[static_cast<std::size_t>(channels + c) * query.count + i];
            for (int corner = 0; corner < 4; ++corner) pull(by_image, image, corner, g * map[image.offset[corner]]);
        }
        const float grad_u = by_image.u + across * by_features.u, grad_v = by_image.v + down * by_features.v;
        project_backward(query.cameras[view], at, grad_u, grad_v, to_xyz + 3 * (first + i));
    }
}

// A copy of each loop for each instruction set; 16 channels are usual.
struct Loops {
    void (*sample)(const Query&, std::size_t, std::size_t, int, const Samples&);
    void (*backward)(const Query&, const float*, std::size_t, std::size_t, int, float*, float*);
};

#define FOURD_LOOPS(NAME, TARGET, CHANNELS)                                                                          \
    TARGET void sample_##NAME(const Query& query, std::size_t view, std::size_t first, int count,                   \
                              const Samples& out) {                                                                 \
        sample_run<CHANNELS>(query, view, first, count, out);                                                       \
    }                                                                                                               \
    TARGET void backward_##NAME(const Query& query, const float* gradient, std::size_t view, std::size_t first,     \
                                int count, float* to_features, float* to_xyz) {                                     \
        backward_run<CHANNELS>(query, gradient, view, first, count, to_features, to_xyz);                           \
    }                                                                                                               \
    constexpr Loops loops_##NAME = {sample_##NAME, backward_##NAME};

FOURD_LOOPS(baseline_16, , 16)
FOURD_LOOPS(baseline_any, , 0)
#if defined(FOURD_X86) && defined(__GNUC__)
FOURD_LOOPS(avx2_16, __attribute__((target("avx2,fma"))), 16)
FOURD_LOOPS(avx2_any, __attribute__((target("avx2,fma"))), 0)
#endif

Loops loops_for(const Query& query) {
    const bool usual = query.maps.channels == 16;
#if defined(FOURD_X86) && defined(__GNUC__)
    if (query.simd != Simd::baseline) return usual ? loops_avx2_16 : loops_avx2_any;
#endif
    return usual ? loops_baseline_16 : loops_baseline_any;
}

constexpr std::size_t kPointsPerTask = 32 * kRun;

// Calls work(first, count) for the points of begin to end, in runs.
template <typename Work>
void for_runs(std::size_t begin, std::size_t end, const Work& work) {
    for (std::size_t first = begin; first < end; first += kRun) {
        work(first, static_cast<int>(std::min<std::size_t>(kRun, end - first)));
    }
}

}  // namespace

void sample(const Query& query, const Samples& out) {
    const Loops loops = loops_for(query);
    const std::size_t parts = (query.count + kPointsPerTask - 1) / kPointsPerTask;
    const int tasks = static_cast<int>(parts * query.views);
    Team team(std::min(query.threads, tasks));
    team.run(tasks, [&](int task, int) {
        const std::size_t view = static_cast<std::size_t>(task) / parts, begin = task % parts * kPointsPerTask;
        for_runs(begin, std::min(query.count, begin + kPointsPerTask),
                 [&](std::size_t first, int count) { loops.sample(query, view, first, count, out); });
    });
}

// A task a view: what is added up belongs to one thread, in one order. xyz is summed over the views after that.
void sample_backward(const Query& query, const float* gradient, const Gradients& out) {
    const Loops loops = loops_for(query);
    const std::size_t views = static_cast<std::size_t>(query.views), numbers = 3 * query.count;
    std::vector<float> by_view(views * numbers);
    Team team(std::min(query.threads, query.views));
    team.run(query.views, [&](int view, int) {
        const std::size_t size = feature_size(query.maps);
        float* const to = out.features ? out.features + view * size : nullptr;
        if (to) std::fill_n(to, size, 0.0f);
        for_runs(0, query.count, [&](std::size_t first, int count) {
            loops.backward(query, gradient, view, first, count, to, by_view.data() + view * numbers);
        });
    });
    std::copy_n(by_view.begin(), numbers, out.xyz);
    for (std::size_t view = 1; view < views; ++view) {
        for (std::size_t i = 0; i < numbers; ++i) out.xyz[i] += by_view[view * numbers + i];
    }
}

}  // namespace fourd::sources
