export const SURFACE = /* glsl */ `
// Converts composited colours, normals and depths to the visible surface (class Surface in
// fourd/rendering/ops/stylize/parameters.py). Row 0 of the result is the top of the image.

uniform sampler2D colours;  // Colours, normals and depths are premultiplied by alpha.
uniform sampler2D normals;    // Normals times front_weight, the weight of a point (octahedral.glsl.js).
uniform sampler2D depths;     // Four channels: front_weight * depth / depth_unit, front_weight, 0, and alpha.
uniform float depth_unit;     // Length of the unit of depths, in world units.
uniform bool is_upside_down;  // Whether row 0 of the inputs is the bottom of the image.
uniform sampler2D old_inverse_depth;
uniform sampler2D old_normal;
uniform float persistence;  // Weight of the previous image's surface, or 0 to ignore it.

layout(location = 0) out vec4 albedo;
layout(location = 1) out float inverse_depth;
layout(location = 2) out vec4 normal;

// Two successive images show the same surface at a pixel if their inverse depths differ by at most the fraction
// SAME_DEPTH, and the cosine between their normals is at least SAME_NORMAL. csrc/points/cpu/surface.inc has the same
// rule.
const float SAME_DEPTH = 0.02;
const float SAME_NORMAL = 0.8;

vec3 bytes(vec3 texel) { return floor(255.0 * texel + 0.5); }

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    ivec2 source = ivec2(pixel.x, is_upside_down ? textureSize(depths, 0).y - 1 - pixel.y : pixel.y);
    vec4 depth = texelFetch(depths, source, 0);
    vec3 sum = texelFetch(normals, source, 0).xyz;
    float alpha = depth.a, coverage = clamp(3.0 * alpha - 0.5, 0.0, 1.0), square = dot(sum, sum);
    albedo = clamp(vec4(texelFetch(colours, source, 0).rgb, alpha), 0.0, 1.0);
    inverse_depth = depth.r > 0.0 ? coverage * depth.g / (depth.r * depth_unit) : 0.0;
    vec3 fresh = floor((square > 1e-12 ? sum * (127.0 / sqrt(square)) : vec3(0.0)) + 128.5);
    vec3 old = bytes(texelFetch(old_normal, pixel, 0).xyz);
    float old_depth = texelFetch(old_inverse_depth, pixel, 0).r;
    bool is_same = abs(old_depth - inverse_depth) <= SAME_DEPTH * inverse_depth
                   && dot(old - 128.0, fresh - 128.0) >= SAME_NORMAL * 127.0 * 127.0;
    float share = is_same ? persistence : 0.0;
    inverse_depth += share * (old_depth - inverse_depth);
    normal = vec4((fresh + share * (old - fresh)) / 255.0, coverage);
}
`;
