// The inner loops over pixels, compiled once for each instruction set.
#include "interpolate/cpu/loops.h"

#include <cstring>

#include "common/inline.h"
#include "interpolate/maths.h"

namespace fourd::interpolate::FOURD_SIMD {
namespace {

// The template argument Channels is the number of channels if it is known at compile time, and 0 otherwise. If Channels
// is 0, the number of channels is query.channels.
template <int Channels>
void forward(const Query& query, const float* attr, std::size_t begin, std::size_t end, float* out, float* out_da) {
    const std::size_t channels = Channels > 0 ? Channels : query.channels, diffs = query.diff_count;
    float last_id = 0.0f;
    Corners corners = {{0, 0, 0}, false};
    for (std::size_t pixel = begin; pixel < end; ++pixel) {
        const float* const from = query.rast + 4 * pixel;
        float* const FOURD_RESTRICT to = out + channels * pixel;
        float* const FOURD_RESTRICT to_da = out_da + 2 * diffs * pixel;
        if (!(from[3] == last_id)) {
            last_id = from[3];
            corners = corners_of(last_id, query.tri, query.triangles, query.vertices, channels);
        }
        if (!corners.is_valid) {
            for (std::size_t c = 0; c < channels; ++c) to[c] = 0.0f;
            for (std::size_t d = 0; d < 2 * diffs; ++d) to_da[d] = 0.0f;
            continue;
        }
        const float* const a0 = attr + corners.at[0];
        const float* const a1 = attr + corners.at[1];
        const float* const a2 = attr + corners.at[2];
        const float u = from[0], v = from[1];
        for (std::size_t c = 0; c < channels; ++c) to[c] = mix(a0[c], a1[c], a2[c], u, v);
        if (diffs == 0) continue;
        const float* const db = query.rast_db + 4 * pixel;
        for (std::size_t d = 0; d < diffs; ++d) {
            const std::int32_t c = query.diff[d];
            const float along_u = a0[c] - a2[c], along_v = a1[c] - a2[c];
            to_da[2 * d] = db[0] * along_u + db[2] * along_v;
            to_da[2 * d + 1] = db[1] * along_u + db[3] * along_v;
        }
    }
}

// Adds the contribution of one pixel to `sums`, and writes the gradients with respect to the pixel's rast and rast_db.
// `sums` (3, channels) holds the gradients with respect to the attributes of the pixel's three vertices.
template <int Channels>
FOURD_INLINE void pixel_gradient(const Query& query, const Gradients& gradients, std::size_t pixel, const float* a0,
                                 const float* a1, const float* a2, float* FOURD_RESTRICT sums) {
    const std::size_t channels = Channels > 0 ? Channels : query.channels;
    const float* const weights = query.rast + 4 * pixel;
    const float* const g = gradients.out + channels * pixel;
    const float u = weights[0], v = weights[1], w = (1.0f - u) - v;
    float grad_u = 0.0f, grad_v = 0.0f;
    for (std::size_t c = 0; c < channels; ++c) {
        grad_u += g[c] * (a0[c] - a2[c]);
        grad_v += g[c] * (a1[c] - a2[c]);
    }
    if (sums != nullptr) {
        for (std::size_t c = 0; c < channels; ++c) {
            sums[c] += u * g[c];
            sums[channels + c] += v * g[c];
            sums[2 * channels + c] += w * g[c];
        }
    }
    if (gradients.rast != nullptr) {
        float* const to = gradients.rast + 4 * pixel;
        to[0] = grad_u, to[1] = grad_v, to[2] = to[3] = 0.0f;
    }
    if (query.diff_count == 0) return;
    const float* const db = query.rast_db + 4 * pixel;
    const float* const g_da = gradients.out_da + 2 * query.diff_count * pixel;
    float grad_db[4] = {};
    for (std::size_t d = 0; d < query.diff_count; ++d) {
        const std::int32_t c = query.diff[d];
        const float g_x = g_da[2 * d], g_y = g_da[2 * d + 1];
        const float along_u = a0[c] - a2[c], along_v = a1[c] - a2[c];
        grad_db[0] += g_x * along_u;
        grad_db[1] += g_y * along_u;
        grad_db[2] += g_x * along_v;
        grad_db[3] += g_y * along_v;
        if (sums == nullptr) continue;
        const float to_0 = g_x * db[0] + g_y * db[1], to_1 = g_x * db[2] + g_y * db[3];
        sums[c] += to_0;
        sums[channels + c] += to_1;
        sums[2 * channels + c] -= to_0 + to_1;
    }
    if (gradients.rast_db != nullptr) std::memcpy(gradients.rast_db + 4 * pixel, grad_db, sizeof grad_db);
}

FOURD_INLINE void clear_pixel(const Gradients& gradients, std::size_t pixel) {
    if (gradients.rast != nullptr) std::memset(gradients.rast + 4 * pixel, 0, 4 * sizeof(float));
    if (gradients.rast_db != nullptr) std::memset(gradients.rast_db + 4 * pixel, 0, 4 * sizeof(float));
}

// Each row of a tile is prefetched kRowsAhead rows before it is used, because the rows are so far apart in memory that
// the processor does not prefetch them by itself.
constexpr int kRowsAhead = 4;

FOURD_INLINE void prefetch_row(const Query& query, const Gradients& gradients, std::size_t pixel, int columns) {
    const std::size_t bytes = static_cast<std::size_t>(columns) * sizeof(float);
    prefetch_bytes(gradients.out + query.channels * pixel, query.channels * bytes);
    if (gradients.rast != nullptr) prefetch_bytes_for_write(gradients.rast + 4 * pixel, 4 * bytes);
    if (gradients.rast_db != nullptr) prefetch_bytes_for_write(gradients.rast_db + 4 * pixel, 4 * bytes);
}

template <int Channels>
void backward(const Query& query, const GradientTile& tile, const Gradients& gradients) {
    const std::size_t channels = Channels > 0 ? Channels : query.channels;
    const int rest_x = query.width - tile.column, rest_y = query.height - tile.row;
    const int columns = rest_x < kTile ? rest_x : kTile, rows = rest_y < kTile ? rest_y : kTile;
    for (int row = 0; row < rows; ++row) {
        const std::size_t pixel =
            tile.first + static_cast<std::size_t>(tile.row + row) * query.width + tile.column;
        const std::int16_t* const slots = tile.slot_of + kTile * row;
        const int ahead = row + kRowsAhead < rows ? kRowsAhead : 0;
        prefetch_row(query, gradients, pixel + static_cast<std::size_t>(ahead) * query.width, columns);
        for (int column = 0; column < columns;) {
            const int slot = slots[column];
            if (slot < 0) {
                clear_pixel(gradients, pixel + column++);
                continue;
            }
            const Corners corners = corners_of(value_of_triangle(tile.visible[slot]), query.tri, query.triangles,
                                               query.vertices, channels);
            float* const sums = tile.sums == nullptr ? nullptr : tile.sums + 3 * channels * slot;
            for (; column < columns && slots[column] == slot; ++column) {
                if (corners.is_valid) {
                    pixel_gradient<Channels>(query, gradients, pixel + column, tile.attr + corners.at[0],
                                             tile.attr + corners.at[1], tile.attr + corners.at[2], sums);
                } else {
                    clear_pixel(gradients, pixel + column);
                }
            }
        }
    }
}

void forward_any(const Query& query, const float* attr, std::size_t begin, std::size_t end, float* out,
                 float* out_da) {
    switch (query.channels) {
        case 1:
            return forward<1>(query, attr, begin, end, out, out_da);
        case 2:
            return forward<2>(query, attr, begin, end, out, out_da);
        case 3:
            return forward<3>(query, attr, begin, end, out, out_da);
        case 4:
            return forward<4>(query, attr, begin, end, out, out_da);
        default:
            return forward<0>(query, attr, begin, end, out, out_da);
    }
}

void backward_any(const Query& query, const GradientTile& tile, const Gradients& gradients) {
    switch (query.channels) {
        case 1:
            return backward<1>(query, tile, gradients);
        case 2:
            return backward<2>(query, tile, gradients);
        case 3:
            return backward<3>(query, tile, gradients);
        case 4:
            return backward<4>(query, tile, gradients);
        default:
            return backward<0>(query, tile, gradients);
    }
}

}  // namespace

const Loops loops = {forward_any, backward_any};

}  // namespace fourd::interpolate::FOURD_SIMD
