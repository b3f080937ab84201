export const GAPS = /* glsl */ `
// Fills the gaps between surfaces, as fill_gaps in fourd/rendering/ops/stylize/reference.py does.

uniform sampler2D inverse_depth;
uniform sampler2D normal;

layout(location = 0) out float closed_depth;
layout(location = 1) out vec4 closed_normal;

const int GAP = 3;  // On each side of a pixel, a surface is searched within GAP pixels.

ivec2 inside(ivec2 pixel) { return clamp(pixel, ivec2(0), textureSize(inverse_depth, 0) - 1); }

// Finds the surface nearest to the camera within GAP pixels in a direction. Returns its inverse depth, and stores its
// pixel in found.
float nearest(ivec2 pixel, ivec2 direction, out ivec2 found) {
    float best = 0.0;
    found = pixel;
    for (int k = 1; k <= GAP; ++k) {
        ivec2 at = inside(pixel + k * direction);
        float depth = texelFetch(inverse_depth, at, 0).r;
        if (depth > best) {
            best = depth;
            found = at;
        }
    }
    return best;
}

// Fills a pixel along an axis if the surfaces on both sides are nearer to the camera than the surface at the pixel. In
// this case, sets depth and source to the inverse depth and the pixel of the farther one of these two surfaces.
void fill(ivec2 pixel, ivec2 axis, inout float depth, inout ivec2 source) {
    ivec2 first_at, second_at;
    float first = nearest(pixel, -axis, first_at), second = nearest(pixel, axis, second_at);
    float gap = min(first, second);
    if (gap > depth) {
        depth = gap;
        source = second < first ? second_at : first_at;
    }
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy), source = pixel;
    float depth = texelFetch(inverse_depth, pixel, 0).r;
    fill(pixel, ivec2(1, 0), depth, source);
    fill(pixel, ivec2(0, 1), depth, source);
    closed_depth = depth;
    closed_normal = texelFetch(normal, source, 0);
}
`;
