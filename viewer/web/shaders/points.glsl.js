export const POINTS = /* glsl */ `
// Projects and shades one point, with the operations of fourd/rendering/ops/points/reference.py and fourd/scene/shade.py
// in the same order. camera.glsl.js must precede this code.

uniform vec3 intrinsics_x;  // The first two rows of the intrinsic matrix.
uniform vec3 intrinsics_y;
uniform vec3 camera_centre;
uniform float near;
uniform float view_weights[MAX_BLENDED];  // Factors for the blend weights of the source views to blend.
uniform int blended_count;
uniform float sh_range;
uniform float sh_base;

const float FADE_SHARE = 0.5;  // Depth over which points fade, as a fraction of the depth of the near plane.

// The shader that contains this code defines the next two functions.
// Returns 16 coefficients of the point's spherical harmonics, for red (0), green (1) or blue (2).
mat4 sh_coefficients(int channel);
// Returns the colour and the blend weight of the point in the k-th of the source views to blend.
vec4 source_view(int k);

// Projects a point at p, in camera axes. Stores its centre (u, v) and its radius rho in pixels, and its density in the
// image. Returns whether the point is drawn.
bool project(vec3 p, float radius, inout float density, out vec2 centre, out float rho) {
    rho = intrinsics_y.y * radius / p.z;
    // Points fade at the near plane (fourd/rendering/ops/play/near_fade.py).
    density *= clamp((p.z - near) / (FADE_SHARE * near), 0.0, 1.0);
    centre = vec2((intrinsics_x.x * p.x + intrinsics_x.y * p.y) / p.z + intrinsics_x.z,
                  (intrinsics_y.x * p.x + intrinsics_y.y * p.y) / p.z + intrinsics_y.z);
    return p.z >= near && density > 0.0 && rho > 0.0 && rho < 1e18;
}

float sh_channel(int channel, mat4 basis) {
    mat4 c = sh_coefficients(channel);
    return dot(c[0], basis[0]) + dot(c[1], basis[1]) + dot(c[2], basis[2]) + dot(c[3], basis[3]);
}

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
    return vec3(sh_channel(0, basis), sh_channel(1, basis), sh_channel(2, basis));
}

vec3 blend_source_views() {
    vec3 sum = vec3(0.0), plain_sum = vec3(0.0);
    float total = 0.0, plain_total = 0.0;
    for (int k = 0; k < blended_count; ++k) {
        vec4 view = source_view(k);
        float weight = view_weights[k] * view.a;
        sum += weight * view.rgb;
        plain_sum += view_weights[k] * view.rgb;
        plain_total += view_weights[k];
        total += weight;
    }
    return total > 0.0 ? sum / max(total, 1e-30) : plain_sum / max(plain_total, 1e-30);
}

vec3 colour_of(vec3 world) {
    vec3 ray = world - camera_centre;
    vec3 direction = ray / max(length(ray), 1e-12);
    return blend_source_views() + sh_base + sh_range * tanh(spherical_harmonics(direction));
}
`;
