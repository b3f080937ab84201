#version 330 core
#include "stylize/octahedral.glsl"
// Projects and shades one point. Transform feedback stores the result, once per image, for all geometry passes. The
// operations and their order are the same as in fourd/rendering/ops/points/reference.py and fourd/scene/shade.py.

uniform sampler2D xyz;            // The textures xyz, radius and density have one texel per point.
uniform sampler2D radius;
uniform sampler2D density;
uniform sampler2D sh;             // Twelve texels per point: 16 coefficients each for red, green and blue.
uniform sampler2D blend_weights;  // One texel per point and source view.
uniform sampler2D rgb;            // One texel per point and source view.
uniform int views;                // Number of source views.
uniform int dynamic_count;        // Number of dynamic points, which are stored first.
uniform int gap;                  // Number of unused slots between the dynamic points and the static background points.

uniform vec3 intrinsics_x;  // The first two rows of the intrinsic matrix.
uniform vec3 intrinsics_y;
uniform vec3 rotation_x;    // The rows of R_camera_world.
uniform vec3 rotation_y;
uniform vec3 rotation_z;
uniform vec3 translation;
uniform vec3 camera_centre;
uniform float near;

uniform int blended_views[64];  // Indices of the source views to blend.
uniform float view_weights[64];  // Factors for the blend weights of these views.
uniform int blended_count;
uniform float sh_range;
uniform float sh_base;

uniform sampler2D normals;  // One texel per point: an octahedral normal in world axes. Not read for COLOURS.
uniform int painted;        // The quantity that the discs show: COLOURS, NORMALS or DEPTHS.
uniform float depth_unit;   // Depths are written as multiples of this length, which is in world units.

const int COLOURS = 0;
const int NORMALS = 1;  // The normal times front_weight.
const int DEPTHS = 2;   // The depth times front_weight, and front_weight itself.

const float FADE_SHARE = 0.5;  // Depth over which points fade, as a fraction of the depth of the near plane.

in uint point;

out vec4 disc;   // Centre (u, v), 1 / rho^2 and the radius rho, with lengths in pixels.
out vec4 paint;  // Red, green and blue (or the values for NORMALS or DEPTHS), and the density.

int slot;  // Index of the point in the textures.

ivec2 at(int texel) { return ivec2(texel & (TEXELS_PER_ROW - 1), texel / TEXELS_PER_ROW); }

float affine(vec3 row, vec3 p, float offset) { return row.x * p.x + row.y * p.y + row.z * p.z + offset; }

vec3 spherical_harmonics(vec3 d) {
    vec3 s = d * d;
    mat4 basis = mat4(
        0.28209479177387814, -0.4886025119029199 * d.y, 0.4886025119029199 * d.z, -0.4886025119029199 * d.x,
        1.0925484305920792 * d.x * d.y, -1.0925484305920792 * d.y * d.z,
        0.31539156525252005 * (2.0 * s.z - s.x - s.y), -1.0925484305920792 * d.x * d.z,
        0.5462742152960396 * (s.x - s.y), -0.5900435899266435 * d.y * (3.0 * s.x - s.y),
        2.890611442640554 * d.x * d.y * d.z, -0.4570457994644658 * d.y * (4.0 * s.z - s.x - s.y),
        0.3731763325901154 * d.z * (2.0 * s.z - 3.0 * s.x - 3.0 * s.y),
        -0.4570457994644658 * d.x * (4.0 * s.z - s.x - s.y), 1.445305721320277 * d.z * (s.x - s.y),
        -0.5900435899266435 * d.x * (s.x - 3.0 * s.y));
    vec3 sum = vec3(0.0);
    int first = 12 * slot;
    for (int k = 0; k < 4; ++k) {
        sum.r += dot(texelFetch(sh, at(first + k), 0), basis[k]);
        sum.g += dot(texelFetch(sh, at(first + 4 + k), 0), basis[k]);
        sum.b += dot(texelFetch(sh, at(first + 8 + k), 0), basis[k]);
    }
    return sum;
}

vec3 blend_source_views() {
    vec3 sum = vec3(0.0), plain_sum = vec3(0.0);
    float total = 0.0, plain_total = 0.0;
    for (int k = 0; k < blended_count; ++k) {
        int texel = slot * views + blended_views[k];
        float weight = view_weights[k] * texelFetch(blend_weights, at(texel), 0).r;
        vec3 colour = texelFetch(rgb, at(texel), 0).rgb;
        sum += weight * colour;
        plain_sum += view_weights[k] * colour;
        plain_total += view_weights[k];
        total += weight;
    }
    return total > 0.0 ? sum / max(total, 1e-30) : plain_sum / max(plain_total, 1e-30);
}

// Returns the normal of the point in camera axes.
vec3 camera_normal() {
    vec3 n = decode_octahedral(texelFetch(normals, at(slot), 0).rg);
    return vec3(dot(rotation_x, n), dot(rotation_y, n), dot(rotation_z, n));
}

vec3 colour_of(vec3 world) {
    vec3 ray = world - camera_centre;
    vec3 direction = ray / max(length(ray), 1e-12);
    return blend_source_views() + sh_base + sh_range * tanh(spherical_harmonics(direction));
}

void main() {
    slot = int(point) < dynamic_count ? int(point) : int(point) + gap;
    vec3 world = texelFetch(xyz, at(slot), 0).xyz;
    vec3 p = vec3(affine(rotation_x, world, translation.x), affine(rotation_y, world, translation.y),
                  affine(rotation_z, world, translation.z));
    float rho = intrinsics_y.y * texelFetch(radius, at(slot), 0).r / p.z;
    float clamped_density = min(texelFetch(density, at(slot), 0).r, 1.0);
    // Points fade at the near plane (fourd/rendering/ops/play/near_fade.py).
    clamped_density *= clamp((p.z - near) / (FADE_SHARE * near), 0.0, 1.0);
    bool is_drawn = p.z >= near && clamped_density > 0.0 && rho > 0.0 && rho < 1e18;
    if (!is_drawn) {
        disc = vec4(-1.0, -1.0, 1.0, 0.0);
        paint = vec4(0.0);
        return;
    }
    disc = vec4((intrinsics_x.x * p.x + intrinsics_x.y * p.y) / p.z + intrinsics_x.z,
                (intrinsics_y.x * p.x + intrinsics_y.y * p.y) / p.z + intrinsics_y.z, 1.0 / (rho * rho), rho);
    paint.a = clamped_density;
    if (painted == COLOURS) {
        paint.rgb = colour_of(world);
        return;
    }
    vec3 normal = camera_normal();
    float weight = front_weight(normal, p);
    paint.rgb = painted == NORMALS ? weight * normal : vec3(weight * p.z / depth_unit, weight, 0.0);
}
