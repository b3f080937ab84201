import { ALPHA } from "../shaders/alpha.glsl.js";
import { PIXEL_FILTER } from "../shaders/pixel_filter.glsl.js";

/** GLSL expression of a disc's depth in the host's normalised device coordinates. */
export const HOST_DEPTH = "depth_range.x + depth_range.y / disc.z";

/**
 * Outputs the premultiplied colour of a disc, unless the disc is behind the host's objects.
 * The second output contains `depth / unit_depth * alpha` and alpha. The division by `unit_depth` keeps depths in the
 * range of float16.
 */
export const HOST_DISC_FRAGMENT = `${ALPHA}
flat in float disc_depth;
uniform bool tests_depth;
uniform sampler2D host_depth;
uniform vec2 host_corner;  // Texel of host_depth at the image's top left pixel.
uniform float unit_depth;
layout(location = 0) out vec4 colour;
layout(location = 1) out vec4 weighted_depth;

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  ivec2 texel = ivec2(host_corner) + ivec2(pixel.x, -pixel.y);
  if (tests_depth && gl_FragCoord.z >= texelFetch(host_depth, texel, 0).r) discard;
  float alpha = disc_alpha();
  colour = vec4(tint.rgb * alpha, alpha);
  weighted_depth = vec4(disc_depth / unit_depth * alpha, 0.0, 0.0, alpha);
}
`;

/** Outputs the filtered premultiplied image. Row 0 is the top of the image. */
export const HOST_COLOUR_FRAGMENT = `
#define POSITION ivec2
${PIXEL_FILTER}
uniform sampler2D image;
uniform vec2 corner;  // Pixel of the target that shows the image's top left pixel.
out vec4 colour;

vec4 tap(ivec2 pixel) { return texelFetch(image, clamp(pixel, ivec2(0), textureSize(image, 0) - 1), 0); }

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy) - ivec2(corner);
  colour = filtered(ivec2(pixel.x, -pixel.y), ivec2(1, 0), ivec2(0, 1));
}
`;

/** Outputs the points' mean depth at pixels where the filtered image has an alpha of at least 0.5. */
export const HOST_DEPTH_FRAGMENT = `
#define POSITION ivec2
${PIXEL_FILTER}
uniform sampler2D weighted_depth;
uniform vec2 corner;
uniform vec2 depth_range;
uniform float unit_depth;
out vec4 nothing;

vec4 tap(ivec2 pixel) {
  return texelFetch(weighted_depth, clamp(pixel, ivec2(0), textureSize(weighted_depth, 0) - 1), 0);
}

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy) - ivec2(corner);
  vec4 texel = filtered(ivec2(pixel.x, -pixel.y), ivec2(1, 0), ivec2(0, 1));
  if (!(texel.a >= 0.5)) discard;
  nothing = vec4(0.0);
  gl_FragDepth = clamp(0.5 + 0.5 * (depth_range.x + depth_range.y / unit_depth * texel.a / texel.r), 0.0, 1.0);
}
`;
