#include "edge_gradients/cpu/loops.h"

#include <cstdint>
#include <cstring>

#include "common/inline.h"
#include "edge_gradients/pairs.h"

namespace fourd::edge_gradients::FOURD_SIMD {
namespace {

#include "antialias/cpu/changes.inc"

std::size_t find(const Plan& plan, const Rows& rows, const float* gradient, float* scratch, std::uint8_t* codes) {
    const View view(plan, rows.image);
    float *ids = scratch, *below = scratch + view.width;
    std::uint8_t* const changes = reinterpret_cast<std::uint8_t*>(scratch + 2 * static_cast<std::size_t>(view.width));
    std::size_t contributions = 0;
    std::memset(codes + view.pixel(rows.begin, 0), 0, view.pixel(rows.end, 0) - view.pixel(rows.begin, 0));
    copy_ids(view.rast(view.pixel(rows.begin, 0)), view.width, below);
    for (int row = rows.begin; row < rows.end; ++row) {
        float* const swapped = ids;
        ids = below, below = swapped;
        const bool has_below = row + 1 < view.height;
        if (has_below) copy_ids(view.rast(view.pixel(row + 1, 0)), view.width, below);
        find_changes(ids, has_below ? below : nullptr, view.width, changes);
        std::uint8_t* const row_codes = codes + view.pixel(row, 0);
        for_nonzero(changes, view.width, [&](int column) FOURD_INLINE_LAMBDA {
            Code code = 0;
            for (int axis = 0; axis < 2; ++axis) {
                if ((changes[column] >> axis & 1) == 0) continue;
                code |= find_edge(view, {row, column, axis}, gradient);
                contributions += static_cast<std::size_t>(vertices_of(code, axis));
            }
            row_codes[column] = static_cast<std::uint8_t>(code);
        });
    }
    return contributions;
}

void contribute(const Plan& plan, const Rows& rows, const float* gradient, const std::uint8_t* codes,
                Contribution* out) {
    const View view(plan, rows.image);
    for (int row = rows.begin; row < rows.end; ++row) {
        const std::uint8_t* const row_codes = codes + view.pixel(row, 0);
        for_nonzero(row_codes, view.width, [&](int column) FOURD_INLINE_LAMBDA {
            for (int axis = 0; axis < 2; ++axis) {
                const Code code = row_codes[column];
                if (vertices_of(code, axis) == 0) continue;
                const auto add = [&](std::size_t vertex, float x, float y, float z, float w) FOURD_INLINE_LAMBDA {
                    *out++ = {static_cast<std::uint32_t>(vertex), x, y, z, w};
                };
                for_motion(view, {row, column, axis}, code, gradient, add);
            }
        });
    }
}

void scatter(const Contribution* contributions, std::size_t count, std::size_t begin, std::size_t end,
             float* positions) {
    if (begin == end) return;
    std::memset(positions + 4 * begin, 0, 4 * (end - begin) * sizeof(float));
    for (std::size_t i = 0; i < count; ++i) {
        const Contribution& one = contributions[i];
        if (one.vertex < begin || one.vertex >= end) continue;
        float* to = positions + 4 * static_cast<std::size_t>(one.vertex);
        to[0] += one.x, to[1] += one.y, to[2] += one.z, to[3] += one.w;
    }
}

}  // namespace

const Loops loops = {find, contribute, scatter};

}  // namespace fourd::edge_gradients::FOURD_SIMD
