// The lookup of one pixel: its position, its two mip levels and their texels.
#pragma once

#include "texture/texture.h"

namespace fourd::texture::cuda {

template <Boundary boundary>
FOURD_HD FOURD_INLINE Texels texels_with(bool is_nearest, int face, float s, float t, int width, int height,
                                         float is_used) {
    return is_nearest ? texels_at<boundary, true>(face, s, t, width, height, is_used)
                      : texels_at<boundary, false>(face, s, t, width, height, is_used);
}

struct Lookup {
    CubePosition on_cube;  // Only for Boundary::cube.
    int face;
    float s, t, is_used;
    Footprint footprint;
    Levels levels;

    FOURD_HD FOURD_INLINE Lookup(const Query& query, std::size_t pixel) : on_cube{}, footprint{} {
        const float* uv = query.uv + static_cast<std::size_t>(query.coordinates()) * pixel;
        if (query.boundary == Boundary::cube) {
            on_cube = cube_position(uv[0], uv[1], uv[2]);
            face = on_cube.face;
            s = on_cube.s;
            t = on_cube.t;
            is_used = on_cube.is_valid ? 1.0f : 0.0f;
        } else {
            const bool is_valid = is_finite(uv[0]) && is_finite(uv[1]);
            const bool wraps = query.boundary == Boundary::wrap;
            const float u = is_valid ? uv[0] : 0.0f, v = is_valid ? uv[1] : 0.0f;
            face = 0;
            s = wraps ? wrapped<Boundary::wrap>(u) : u;
            t = wraps ? wrapped<Boundary::wrap>(v) : v;
            is_used = is_valid ? 1.0f : 0.0f;
        }
        levels = levels_of(query, pixel);
    }

    FOURD_HD FOURD_INLINE Texels texels(const Query& query, int level) const {
        const Shape& shape = query.texture.shape;
        const int width = side_at(shape.width, level), height = side_at(shape.height, level);
        const bool is_nearest = query.filter == Filter::nearest;
        switch (query.boundary) {
            case Boundary::wrap: return texels_with<Boundary::wrap>(is_nearest, face, s, t, width, height, is_used);
            case Boundary::clamp: return texels_with<Boundary::clamp>(is_nearest, face, s, t, width, height, is_used);
            case Boundary::zero: return texels_with<Boundary::zero>(is_nearest, face, s, t, width, height, is_used);
            default: return texels_with<Boundary::cube>(is_nearest, face, s, t, width, height, is_used);
        }
    }

  private:
    FOURD_HD FOURD_INLINE Levels levels_of(const Query& query, std::size_t pixel) {
        const Shape& shape = query.texture.shape;
        if (!uses_mips(query.filter)) return {0, 0, 0.0f, false};
        float level = 0.0f;
        if (query.uv_da) {
            footprint = footprint_of(query, pixel);
            level = level_of(footprint);
        }
        if (query.bias) level += query.bias[pixel];
        return levels_at(clamped_level(level, shape.level_count), shape.level_count, query.filter);
    }

    FOURD_HD FOURD_INLINE Footprint footprint_of(const Query& query, std::size_t pixel) const {
        const Shape& shape = query.texture.shape;
        if (query.boundary == Boundary::cube) return cube_footprint(on_cube, query.uv_da + 6 * pixel, shape.width);
        const float width = static_cast<float>(shape.width), height = static_cast<float>(shape.height);
        const float* d = query.uv_da + 4 * pixel;
        return {limited_derivative(d[0] * width), limited_derivative(d[1] * width), limited_derivative(d[2] * height),
                limited_derivative(d[3] * height)};
    }
};

}  // namespace fourd::texture::cuda
