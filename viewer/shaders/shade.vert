#version 330 core
// A point projected and coloured, once a picture: transform feedback keeps it for the passes that draw it.
// fourd/raster/reference.py and fourd/baking/shade.py say what is computed; these are their operations in order.

uniform sampler2D xyz;            // a texel a point
uniform sampler2D radius;
uniform sampler2D density;
uniform sampler2D sh;             // 12 texels a point: red's 16 terms, then green's and blue's
uniform sampler2D blend_weights;  // `views` texels a point
uniform sampler2D rgb;            // likewise
uniform int views;
uniform int moving;               // so many points lie first,
uniform int gap;                  // and the others after so many that are not there

uniform vec3 intrinsics_x;  // the first two rows of K
uniform vec3 intrinsics_y;
uniform vec3 rotation_x;    // the rows of R_camera_world
uniform vec3 rotation_y;
uniform vec3 rotation_z;
uniform vec3 translation;
uniform vec3 centre;
uniform float near;

uniform int chosen[64];  // the source views to blend
uniform int chosen_count;
uniform float sh_range;
uniform float sh_base;

in uint point;

out vec4 disc;   // u, v, 1 / rho^2, rho; in pixels
out vec4 paint;  // red, green, blue, density

int place;  // of the point in the textures

ivec2 at(int texel) { return ivec2(texel & (TEXELS_A_ROW - 1), texel / TEXELS_A_ROW); }

float along(vec3 row, vec3 p, float offset) { return row.x * p.x + row.y * p.y + row.z * p.z + offset; }

vec3 harmonics(vec3 d) {
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
    int first = 12 * place;
    for (int k = 0; k < 4; ++k) {
        sum.r += dot(texelFetch(sh, at(first + k), 0), basis[k]);
        sum.g += dot(texelFetch(sh, at(first + 4 + k), 0), basis[k]);
        sum.b += dot(texelFetch(sh, at(first + 8 + k), 0), basis[k]);
    }
    return sum;
}

vec3 blended() {
    vec3 sum = vec3(0.0), plain = vec3(0.0);
    float total = 0.0;
    for (int k = 0; k < chosen_count; ++k) {
        int texel = place * views + chosen[k];
        float weight = texelFetch(blend_weights, at(texel), 0).r;
        vec3 colour = texelFetch(rgb, at(texel), 0).rgb;
        sum += weight * colour;
        plain += colour;
        total += weight;
    }
    return total > 0.0 ? sum / max(total, 1e-6) : plain / float(max(chosen_count, 1));
}

void main() {
    place = int(point) < moving ? int(point) : int(point) + gap;
    vec3 world = texelFetch(xyz, at(place), 0).xyz;
    vec3 p = vec3(along(rotation_x, world, translation.x), along(rotation_y, world, translation.y),
                  along(rotation_z, world, translation.z));
    float rho = intrinsics_y.y * texelFetch(radius, at(place), 0).r / p.z;
    float dense = min(texelFetch(density, at(place), 0).r, 1.0);
    bool seen = p.z >= near && dense > 0.0 && rho > 0.0 && rho < 1e18;
    if (!seen) {
        disc = vec4(-1.0, -1.0, 1.0, 0.0);
        paint = vec4(0.0);
        return;
    }
    disc = vec4((intrinsics_x.x * p.x + intrinsics_x.y * p.y) / p.z + intrinsics_x.z,
                (intrinsics_y.x * p.x + intrinsics_y.y * p.y) / p.z + intrinsics_y.z, 1.0 / (rho * rho), rho);
    vec3 towards = world - centre;
    vec3 direction = towards / max(length(towards), 1e-12);
    paint = vec4(blended() + sh_base + sh_range * tanh(harmonics(direction)), dense);
}
