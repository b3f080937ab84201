// Geometry of cube maps, shared by every backend. The outward normals of the six faces are +x, -x, +y, -y, +z and -z.
// The faces are oriented as in OpenGL.
#pragma once

#include "texture/maths.h"

namespace fourd::texture {

// The axes of a face. A ray from the cube's centre in the direction xyz = (x, y, z) meets the face at (s, t):
//     s = 0.5 * (a / m + 1), t = 0.5 * (b / m + 1)
// Here a = s_sign * xyz[s_axis], b = t_sign * xyz[t_axis] and m = m_sign * xyz[m_axis], which is positive. m_axis is
// the axis of the face's normal.
struct CubeFace {
    int s_axis, t_axis, m_axis;
    int s_sign, t_sign, m_sign;
};

FOURD_HD FOURD_INLINE CubeFace cube_face(int face) {
    const int axis = face / 2;
    return {axis == 0 ? 2 : 0,
            axis == 1 ? 2 : 1,
            axis,
            face == 0 || face == 5 ? -1 : 1,
            face == 2 ? 1 : -1,
            face % 2 == 0 ? 1 : -1};
}

// The point at which a ray from the centre of the cube meets a face. A direction that is zero or not finite meets no
// face, and has m = 1.
struct CubePosition {
    int face;
    float a, b, m;
    float s, t;  // In [0, 1].
    bool is_valid;
};

FOURD_HD FOURD_INLINE CubePosition cube_position(float x, float y, float z) {
    const float ax = absolute(x), ay = absolute(y), az = absolute(z);
    const bool on_z = az > ax && az > ay, on_y = !on_z && ay > ax;
    const float along = on_z ? z : on_y ? y : x;
    CubePosition out;
    out.face = (on_z ? 4 : on_y ? 2 : 0) + (along < 0.0f ? 1 : 0);
    out.is_valid = is_finite(x) && is_finite(y) && is_finite(z) && along != 0.0f;
    out.m = out.is_valid ? absolute(along) : 1.0f;
    const float s = on_z || on_y ? x : z, t = on_y ? z : y;
    out.a = !out.is_valid ? 0.0f : out.face == 0 || out.face == 5 ? -s : s;
    out.b = !out.is_valid ? 0.0f : out.face == 2 ? t : -t;
    out.s = 0.5f * (out.a / out.m) + 0.5f;
    out.t = 0.5f * (out.b / out.m) + 0.5f;
    return out;
}

// Returns the footprint of a lookup on a cube with faces of size x size texels. uv_da has the derivatives of the
// direction (x, y, z) with respect to the picture coordinates (X, Y): dx/dX, dx/dY, dy/dX, dy/dY, dz/dX, dz/dY.
FOURD_HD FOURD_INLINE Footprint cube_footprint(const CubePosition& at, const float* uv_da, int size) {
    const CubeFace f = cube_face(at.face);
    const float scale = 0.5f * static_cast<float>(size) / at.m, by_s = at.a / at.m, by_t = at.b / at.m;
    float d[4];
    for (int k = 0; k < 2; ++k) {
        const float m = static_cast<float>(f.m_sign) * uv_da[2 * f.m_axis + k];
        d[k] = scale * (static_cast<float>(f.s_sign) * uv_da[2 * f.s_axis + k] - by_s * m);
        d[2 + k] = scale * (static_cast<float>(f.t_sign) * uv_da[2 * f.t_axis + k] - by_t * m);
    }
    return {limited_derivative(d[0]), limited_derivative(d[1]), limited_derivative(d[2]), limited_derivative(d[3])};
}

// The backward pass of cube_position. Adds the gradient with respect to the direction to grad_uv (3,). grad_s and
// grad_t are the gradients with respect to s and t.
FOURD_HD FOURD_INLINE void cube_position_backward(const CubePosition& at, float grad_s, float grad_t, float* grad_uv) {
    if (!at.is_valid) return;
    const CubeFace f = cube_face(at.face);
    const float scale = 0.5f / at.m;
    grad_uv[f.s_axis] += static_cast<float>(f.s_sign) * scale * grad_s;
    grad_uv[f.t_axis] += static_cast<float>(f.t_sign) * scale * grad_t;
    grad_uv[f.m_axis] -= static_cast<float>(f.m_sign) * scale * (grad_s * (at.a / at.m) + grad_t * (at.b / at.m));
}

// The backward pass of cube_footprint. Adds the gradient with respect to the direction to grad_uv (3,), and the
// gradient with respect to uv_da to grad_uv_da (6,).
FOURD_HD FOURD_INLINE void cube_footprint_backward(const CubePosition& at, const float* uv_da, int size,
                                                   const Footprint& gradient, float* grad_uv, float* grad_uv_da) {
    if (!at.is_valid) return;
    const CubeFace f = cube_face(at.face);
    const float scale = 0.5f * static_cast<float>(size) / at.m, by_s = at.a / at.m, by_t = at.b / at.m;
    const float s_sign = static_cast<float>(f.s_sign), t_sign = static_cast<float>(f.t_sign),
                m_sign = static_cast<float>(f.m_sign);
    const float to_s[2] = {gradient.s_x, gradient.s_y}, to_t[2] = {gradient.t_x, gradient.t_y};
    for (int k = 0; k < 2; ++k) {
        const float m = m_sign * uv_da[2 * f.m_axis + k], per_m = m / at.m;
        const float s = scale * (s_sign * uv_da[2 * f.s_axis + k] - by_s * m);
        const float t = scale * (t_sign * uv_da[2 * f.t_axis + k] - by_t * m);
        grad_uv_da[2 * f.s_axis + k] += s_sign * scale * to_s[k];
        grad_uv_da[2 * f.t_axis + k] += t_sign * scale * to_t[k];
        grad_uv_da[2 * f.m_axis + k] -= m_sign * scale * (by_s * to_s[k] + by_t * to_t[k]);
        grad_uv[f.s_axis] -= s_sign * scale * per_m * to_s[k];
        grad_uv[f.t_axis] -= t_sign * scale * per_m * to_t[k];
        grad_uv[f.m_axis] += m_sign * (to_s[k] * (scale * by_s * per_m - s / at.m) +
                                       to_t[k] * (scale * by_t * per_m - t / at.m));
    }
}

// Returns the index of a texel on a neighbouring face. The texel is given in the grid of `face`: its column or its row
// is one texel outside `face`.
FOURD_HD FOURD_INLINE int neighbour_texel(int face, int column, int row, int size) {
    // The unit of positions is half a texel, and the faces of the cube are at +-size.
    const CubeFace f = cube_face(face);
    const bool is_beside = column < 0 || column >= size;
    int at[3];
    at[f.s_axis] = f.s_sign * (2 * column + 1 - size);
    at[f.t_axis] = f.t_sign * (2 * row + 1 - size);
    const int axis = is_beside ? f.s_axis : f.t_axis;
    const bool is_negative = at[axis] < 0;
    // The two faces meet at a right angle. On the neighbouring face, which is perpendicular to `axis`, the centre of
    // the texel is half a texel from the edge.
    at[axis] = is_negative ? -size : size;
    at[f.m_axis] = f.m_sign * (size - 1);
    const int other = 2 * axis + (is_negative ? 1 : 0);
    const CubeFace g = cube_face(other);
    const int other_column = (g.s_sign * at[g.s_axis] + size - 1) / 2;
    const int other_row = (g.t_sign * at[g.t_axis] + size - 1) / 2;
    return (other * size + other_row) * size + other_column;
}

// Returns the four texels of a bilinear lookup on a cube. At a corner of the cube, one of the four texels does not
// exist. Its value is the mean of the other three, so its weight is divided among them.
FOURD_HD FOURD_INLINE Texels cube_texels(int face, float s, float t, int size, float is_used) {
    const Axis across = linear_axis<Boundary::cube>(s, size), down = linear_axis<Boundary::cube>(t, size);
    Texels out = texels_of(across, down, face * size * size, size, is_used);
    if (across.index[0] >= 0 && across.index[1] < size && down.index[0] >= 0 && down.index[1] < size) return out;
    int missing = -1;
    for (int k = 0; k < 4; ++k) {
        const int column = across.index[k % 2], row = down.index[k / 2];
        const bool is_beside = column < 0 || column >= size, is_above = row < 0 || row >= size;
        if (is_beside && is_above) {
            missing = k;
        } else if (is_beside || is_above) {
            out.index[k] = neighbour_texel(face, column, row, size);
        }
    }
    if (missing < 0) return out;
    out.index[missing] = out.index[missing ^ 1];
    for (int k = 0; k < 4; ++k) {
        if (k == missing) continue;
        out.weight[k] += out.weight[missing] * (1.0f / 3.0f);
        out.along_s[k] += out.along_s[missing] * (1.0f / 3.0f);
        out.along_t[k] += out.along_t[missing] * (1.0f / 3.0f);
    }
    out.weight[missing] = out.along_s[missing] = out.along_t[missing] = 0.0f;
    return out;
}

// Returns the texels of a lookup in an image of width x height texels. `face` is 0 unless the boundary mode is cube.
template <Boundary boundary, bool is_nearest>
FOURD_HD FOURD_INLINE Texels texels_at(int face, float s, float t, int width, int height, float is_used) {
    if (boundary == Boundary::cube && !is_nearest) return cube_texels(face, s, t, width, is_used);
    const int first = boundary == Boundary::cube ? face * width * width : 0;
    return texels_of(axis_at<boundary, is_nearest>(s, width), axis_at<boundary, is_nearest>(t, height), first, width,
                     is_used);
}

}  // namespace fourd::texture
