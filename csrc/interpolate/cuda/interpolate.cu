#include "interpolate/cuda/interpolate.h"

#include "device/clear.h"
#include "device/executor.h"
#include "interpolate/maths.h"

namespace fourd::interpolate::cuda {
namespace {

// A pixel and the attributes of the vertices of its triangle.
struct Pixel {
    Corners corners;
    const float* a0;
    const float* a1;
    const float* a2;
    std::size_t first;  // Index, in Query::attr, of the image's first attribute.

    FOURD_DEVICE Pixel(const Query& query, std::size_t index) {
        corners = corners_of(query.rast[4 * index + 3], query.tri, query.triangles, query.vertices, query.channels);
        first = index / query.pixels() * query.image_stride * query.channels;
        a0 = query.attr + first + corners.at[0];
        a1 = query.attr + first + corners.at[1];
        a2 = query.attr + first + corners.at[2];
    }
};

struct Forward {
    Query query;
    float* out;
    float* out_da;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Pixel pixel(query, index);
        float* const to = out + query.channels * index;
        float* const to_da = out_da + 2 * query.diff_count * index;
        const float u = query.rast[4 * index], v = query.rast[4 * index + 1];
        for (std::size_t c = 0; c < query.channels; ++c) {
            to[c] = pixel.corners.is_valid ? mix(pixel.a0[c], pixel.a1[c], pixel.a2[c], u, v) : 0.0f;
        }
        for (std::size_t d = 0; d < query.diff_count; ++d) {
            to_da[2 * d] = to_da[2 * d + 1] = 0.0f;
            if (!pixel.corners.is_valid) continue;
            const std::int32_t c = query.diff[d];
            const float* const db = query.rast_db + 4 * index;
            const float along_u = pixel.a0[c] - pixel.a2[c], along_v = pixel.a1[c] - pixel.a2[c];
            to_da[2 * d] = db[0] * along_u + db[2] * along_v;
            to_da[2 * d + 1] = db[1] * along_u + db[3] * along_v;
        }
    }
};

struct Backward {
    Query query;
    Gradients gradients;

    FOURD_DEVICE void add(const Pixel& pixel, std::size_t channel, float to_0, float to_1, float to_2) const {
        if (gradients.attr == nullptr) return;
        float* const to = gradients.attr + pixel.first + channel;
        device::atomic_add(to + pixel.corners.at[0], to_0);
        device::atomic_add(to + pixel.corners.at[1], to_1);
        device::atomic_add(to + pixel.corners.at[2], to_2);
    }

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Pixel pixel(query, index);
        float to_rast[4] = {0.0f, 0.0f, 0.0f, 0.0f}, to_db[4] = {0.0f, 0.0f, 0.0f, 0.0f};
        if (pixel.corners.is_valid) {
            const float u = query.rast[4 * index], v = query.rast[4 * index + 1];
            for (std::size_t c = 0; c < query.channels; ++c) {
                const float g = gradients.out[query.channels * index + c];
                to_rast[0] += g * (pixel.a0[c] - pixel.a2[c]);
                to_rast[1] += g * (pixel.a1[c] - pixel.a2[c]);
                add(pixel, c, u * g, v * g, ((1.0f - u) - v) * g);
            }
            for (std::size_t d = 0; d < query.diff_count; ++d) {
                const std::int32_t c = query.diff[d];
                const float* const db = query.rast_db + 4 * index;
                const float* const g = gradients.out_da + 2 * (query.diff_count * index + d);
                const float along_u = pixel.a0[c] - pixel.a2[c], along_v = pixel.a1[c] - pixel.a2[c];
                to_db[0] += g[0] * along_u;
                to_db[1] += g[1] * along_u;
                to_db[2] += g[0] * along_v;
                to_db[3] += g[1] * along_v;
                const float to_0 = g[0] * db[0] + g[1] * db[1], to_1 = g[0] * db[2] + g[1] * db[3];
                add(pixel, static_cast<std::size_t>(c), to_0, to_1, -(to_0 + to_1));
            }
        }
        for (int i = 0; i < 4; ++i) {
            if (gradients.rast != nullptr) gradients.rast[4 * index + i] = to_rast[i];
            if (gradients.rast_db != nullptr) gradients.rast_db[4 * index + i] = to_db[i];
        }
    }
};

}  // namespace

void interpolate(const Query& query, float* out, float* out_da, void* stream) {
    device::Executor(stream).for_each(query.pixels() * query.images, Forward{query, out, out_da});
}

void interpolate_backward(const Query& query, const Gradients& gradients, void* stream) {
    const device::Executor executor(stream);
    const std::size_t copies = query.image_stride == 0 ? 1 : static_cast<std::size_t>(query.images);
    if (gradients.attr != nullptr) {
        executor.for_each(copies * query.vertices * query.channels, device::Clear{gradients.attr});
    }
    executor.for_each(query.pixels() * query.images, Backward{query, gradients});
}

}  // namespace fourd::interpolate::cuda
