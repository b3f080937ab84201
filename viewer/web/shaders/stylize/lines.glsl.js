export const LINES = /* glsl */ `
// Finds lines, as find_lines in fourd/rendering/ops/stylize/reference.py does.

uniform float ray[6];  // The first two rows of the inverse intrinsic matrix.
uniform sampler2D closed_depth;
uniform sampler2D closed_normal;
uniform int line_filter;  // 0 for none, 1 for Sobel, 2 for the cross filter.
uniform int thickness;    // Distance, in pixels, between adjacent taps of the filter.
uniform float depth_threshold;
uniform float normal_threshold;
uniform highp usampler2D line_state;  // The state of the previous image, in the layout of csrc/stylize/stylize.h.
uniform bool has_state;               // Whether the previous image has the same camera, size and style.
uniform float hysteresis;
uniform float persistence;

// The surface at a pixel counts as unchanged if the summed inverse depths of its taps differ by at most this fraction
// from the sum in the previous image. csrc/stylize/cpu/lines.inc has the same rule.
const float SAME_TAPS = 0.03;

// Slope with which lines fade out at surfaces that face away from the camera. Let m be the largest dot product of the
// pixel's ray and a tap's normal. A line has its full strength at m = 0, and strength 0 at m = 1 / FRONT_SLOPE.
const float FRONT_SLOPE = 8.0;

// Returns the ray of a pixel in camera axes, scaled to depth 1.
vec3 ray_of(ivec2 pixel) {
    vec2 position = vec2(pixel) + 0.5;
    return vec3(ray[0] * position.x + ray[1] * position.y + ray[2], ray[3] * position.x + ray[4] * position.y + ray[5], 1.0);
}

vec4 unpack_normal(vec4 texel) { return vec4((floor(255.0 * texel.xyz + 0.5) - 128.0) / 127.0, texel.w); }

// Returns a value that increases linearly from 0 at the threshold to 1 at 1.5 times the threshold.
float ramp(float value, float threshold) { return clamp(2.0 * (value / threshold - 1.0), 0.0, 1.0); }

ivec2 tap_pixel(ivec2 pixel, ivec2 steps) {
    return clamp(pixel + thickness * steps, ivec2(0), textureSize(closed_depth, 0) - 1);
}

float tap_depth(ivec2 pixel, int right, int down) {
    return texelFetch(closed_depth, tap_pixel(pixel, ivec2(right, down)), 0).r;
}

// Returns the inverse depth of a tap, and the cosine between its normal and normal, both multiplied by the coverage
// of the tap.
vec2 tap(ivec2 pixel, ivec2 steps, vec3 normal) {
    ivec2 at = tap_pixel(pixel, steps);
    vec4 other = unpack_normal(texelFetch(closed_normal, at, 0));
    return vec2(texelFetch(closed_depth, at, 0).r, dot(other.xyz * other.w, normal));
}

float sobel_lines(ivec2 pixel, vec3 normal, float scale) {
    vec2 across = vec2(0.0), down = vec2(0.0);
    float most = 1e-20;
    for (int y = -1; y <= 1; ++y) {
        for (int x = -1; x <= 1; ++x) {
            vec2 value = tap(pixel, ivec2(x, y), normal);
            across += float(x * (2 - abs(y))) * value;
            down += float(y * (2 - abs(x))) * value;
            most = max(most, value.x);
        }
    }
    vec2 size = sqrt(across * across + down * down) / 4.0;
    return max(ramp(size.x / most, depth_threshold * scale), ramp(size.y, normal_threshold * scale));
}

float cross_lines(ivec2 pixel, vec3 normal, float coverage, float scale) {
    float depth = texelFetch(closed_depth, pixel, 0).r, most = max(depth, 1e-20), bend = 0.0, flatness = 1.0;
    ivec2 size = textureSize(closed_depth, 0);
    for (int axis = 0; axis < 2; ++axis) {
        ivec2 side = axis == 0 ? ivec2(0, 1) : ivec2(1, 0);
        vec2 first = tap(pixel, -side, normal), second = tap(pixel, side, normal);
        int at = axis == 0 ? pixel.y : pixel.x, count = axis == 0 ? size.y : size.x;
        // A tap outside the image repeats a pixel of the border. A second difference with such a tap would look like a
        // bend in the surface, so the second difference is left out near the border.
        if (at >= thickness && at < count - thickness) bend += abs(first.x + second.x - 2.0 * depth);
        most = max(most, max(first.x, second.x));
        flatness *= 1.0 - ramp(coverage - first.y, normal_threshold * scale);
        flatness *= 1.0 - ramp(coverage - second.y, normal_threshold * scale);
    }
    return 1.0 - flatness * (1.0 - ramp(bend / (2.0 * most), depth_threshold * scale));
}

// Returns the factor by which a line's strength is multiplied. To suppress false lines, it decreases to 0 if a tap
// shows the back of a surface through a hole between points. If any tap shows no surface, the factor is 1.
float kept_line(ivec2 pixel) {
    vec3 towards = ray_of(pixel);
    float away = 0.0, coverage = 1.0;
    for (int y = -1; y <= 1; ++y) {
        for (int x = -1; x <= 1; ++x) {
            if (line_filter == 2 && x != 0 && y != 0) continue;
            ivec2 at = tap_pixel(pixel, ivec2(x, y));
            vec4 tap = unpack_normal(texelFetch(closed_normal, at, 0));
            away = max(away, dot(tap.xyz * tap.w, towards));
            coverage = min(coverage, tap.w);
        }
    }
    return max(1.0 - FRONT_SLOPE * away, 1.0 - coverage);
}

// Returns the strength, in [0, 1], of the line at a pixel, independently of the previous image. The thresholds are
// multiplied by scale.
float fresh_line(ivec2 pixel, float scale) {
    vec4 own = unpack_normal(texelFetch(closed_normal, pixel, 0));
    vec3 normal = own.xyz * own.w;
    float line = line_filter == 1 ? sobel_lines(pixel, normal, scale) : cross_lines(pixel, normal, own.w, scale);
    return line > 0.0 ? line * kept_line(pixel) : 0.0;
}

// Returns the sum of the inverse depths of nine taps as the bits of a float32, with the lower 16 bits set to 0.
uint summed_taps(ivec2 pixel) {
    float corners = (tap_depth(pixel, -1, -1) + tap_depth(pixel, 1, -1))
                    + (tap_depth(pixel, -1, 1) + tap_depth(pixel, 1, 1));
    float arms = (tap_depth(pixel, 0, -1) + tap_depth(pixel, 0, 1)) + (tap_depth(pixel, -1, 0) + tap_depth(pixel, 1, 0));
    return floatBitsToUint((corners + arms) + tap_depth(pixel, 0, 0)) & 0xffff0000u;
}

// Returns the state of the line at a pixel. To avoid flicker, thresholds are lower where the previous image has a line,
// and lines gain strength slowly where the surface has not changed.
uint find_line(ivec2 pixel) {
    if (line_filter == 0) return 0u;
    uint old = has_state ? texelFetch(line_state, pixel, 0).r : 0u;
    float before = float(old & 255u) / 255.0;
    float line = fresh_line(pixel, (old & 255u) >= 128u ? 1.0 - hysteresis : 1.0);
    uint bits = summed_taps(pixel);
    float seen = uintBitsToFloat(bits), old_seen = uintBitsToFloat(old & 0xffff0000u);
    if (abs(seen - old_seen) <= SAME_TAPS * seen && line > before) line += persistence * (before - line);
    return bits | uint(line * 255.0 + 0.5);
}
`;
