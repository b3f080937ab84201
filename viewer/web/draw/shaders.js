/**
 * GLSL ES 3.00 shaders. The player shares viewer/web/shaders/ with the viewer's window (viewer/shader_files.py), where the
 * same text is GLSL 3.30.
 */
import { ALPHA } from "../shaders/alpha.glsl.js";
import { CAMERA } from "../shaders/camera.glsl.js";
import { PEEL } from "../shaders/peel.frag.js";
import { PIXEL_FILTER } from "../shaders/pixel_filter.glsl.js";
import { POINTS } from "../shaders/points.glsl.js";
import { QUAD } from "../shaders/quad.vert.js";
import { SORTED } from "../shaders/sorted.frag.js";
import { SPRITE } from "../shaders/sprite.vert.js";

/**
 * Multiplies the factors of a cloud by the basis of its spherical harmonics. Each fragment computes 8 of a point's 48
 * coefficients and packs them as float16 values. Block b of the target contains the coefficients `8 * b` to `8 * b +
 * 7`.
 */
export const HARMONICS_FRAGMENT = `
uniform isampler2D factors;  // Row-major (K, N).
uniform int rows;            // K
uniform int points;          // N
uniform int block;
uniform int first_row;       // First row of this cloud and block in the target.
layout(std140) uniform Basis {
  vec4 basis[576];  // (48, 12)
  vec4 mean[12];
};
out uvec4 coefficients;

void main() {
  int point = int(gl_FragCoord.x) + (int(gl_FragCoord.y) - first_row) * TEXELS_PER_ROW;
  vec4 first = mean[2 * block], second = mean[2 * block + 1];
  for (int k = 0; k < rows; ++k) {
    int texel = k * points + point;
    float factor = float(texelFetch(factors, ivec2(texel & (TEXELS_PER_ROW - 1), texel / TEXELS_PER_ROW), 0).r);
    first += factor * basis[12 * k + 2 * block];
    second += factor * basis[12 * k + 2 * block + 1];
  }
  coefficients = uvec4(packHalf2x16(first.xy), packHalf2x16(first.zw),
                       packHalf2x16(second.xy), packHalf2x16(second.zw));
}
`;

/** Projects and shades one point. Transform feedback stores the result once per image. */
export const SHADE_VERTEX = `${CAMERA}${POINTS}
uniform sampler2D xyz;
uniform usampler2D sizes;        // Radius code in the low 16 bits, density code in the next 8 bits.
uniform usampler2D harmonics;    // Six blocks of rows. Each texel has 8 float16 values.
uniform sampler2DArray views;    // Colour, and code of the blend weight. Layer 0 has the mean colours.
uniform usampler2D shadow;       // One texel per background point.
uniform bool has_shadow;
uniform int block_rows;          // Number of texture rows of one block of harmonics.
uniform int background_first;    // Index of the first background point.

// Element 0 is for the dynamic points, and element 1 is for the background. The components are the radius of code 1,
// the number of radius codes per octave, and the number of density levels.
uniform vec4 radius_density[2];
uniform float weight_steps[2];

uniform int blended_layers[MAX_BLENDED];

in uint point;
out vec4 disc;   // Centre (u, v) in pixels, depth in world units, and radius rho in pixels.
out vec4 paint;  // Red, green, blue and density.

int slot;  // Index of the point in the textures.
int cloud;
float shadow_factor;

void read_block(int block, out vec4 first, out vec4 second) {
  ivec2 texel = at(slot);
  uvec4 packed = texelFetch(harmonics, ivec2(texel.x, texel.y + block * block_rows), 0);
  first = vec4(unpackHalf2x16(packed.x), unpackHalf2x16(packed.y));
  second = vec4(unpackHalf2x16(packed.z), unpackHalf2x16(packed.w));
}

mat4 sh_coefficients(int channel) {
  vec4 a, b, c, d;
  read_block(2 * channel, a, b);
  read_block(2 * channel + 1, c, d);
  return mat4(a, b, c, d);
}

vec4 source_view(int k) {
  vec4 view = texelFetch(views, ivec3(at(slot), blended_layers[k]), 0);
  if (cloud == 1 && has_shadow) view.rgb = min(floor(view.rgb * 255.0 * shadow_factor + 0.5), 255.0) / 255.0;
  float code = view.a * 255.0;
  return vec4(view.rgb, code > 0.5 ? 1024.0 * exp2((1.0 - code) / weight_steps[cloud]) : 0.0);
}

void main() {
  slot = int(point);
  cloud = slot < background_first ? 0 : 1;
  shadow_factor = cloud == 1 && has_shadow ? float(texelFetch(shadow, at(slot - background_first), 0).r) / 128.0 : 1.0;
  vec3 world = texelFetch(xyz, at(slot), 0).xyz, p = to_camera(world);
  uint size = texelFetch(sizes, at(slot), 0).r;
  vec4 scale = radius_density[cloud];
  float code = float(size & 0xffffu);
  float radius = code > 0.5 ? scale.x * exp2((code - 1.0) / scale.y) : 0.0;
  float rho, density = min(float(size >> 16u) / scale.z, 1.0);
  vec2 centre;
  gl_Position = vec4(0.0);
  gl_PointSize = 1.0;
  if (!project(p, radius, density, centre, rho)) {
    disc = vec4(-1.0, -1.0, near, 0.0);
    paint = vec4(0.0);
    return;
  }
  disc = vec4(centre, p.z, rho);
  paint = vec4(colour_of(world), density);
}
`;

/** Outputs 0. This shader exists only because WebGL requires a fragment shader, even though transform feedback discards
 * all fragments. */
export const NO_FRAGMENT = `
out vec4 nothing;
void main() { nothing = vec4(0.0); }
`;

/** GLSL expression of a disc's depth for depth peeling, which peels discs by their rank. */
export const RANK_DEPTH = "2.0 * (rank - 0.5) / 16777216.0 - 1.0";
/** GLSL expression of a disc's depth for passes that neither test nor store depths. */
export const NO_DEPTH = "0.0";

/**
 * Declares a disc, and writes its outputs. Row 0 of the image is at the bottom of the framebuffer.
 * @param {string} depth GLSL expression of the depth in normalised device coordinates.
 * @param {boolean} hasNormals Whether discs have a normal and a weight, which fragments read as `disc_normal`.
 */
const discVertex = (depth, hasNormals) => `
uniform vec2 size;
uniform vec2 depth_range;
in vec4 disc;
in vec4 paint;
${hasNormals ? "in vec4 normal;\nflat out vec4 disc_normal;" : ""}
flat out vec3 disc_centre;
flat out float disc_depth;
flat out vec4 tint;
flat out float rank;

void write_outputs(vec2 position, int index) {
  disc_centre = vec3(disc.xy, disc.w > 0.0 ? 1.0 / (disc.w * disc.w) : 1.0);
  disc_depth = disc.z;
  tint = paint;
  rank = float(index + 1);
  ${hasNormals ? "disc_normal = normal;" : ""}
  gl_Position = vec4(position, ${depth}, 1.0);
}
`;

/**
 * The vertex shader that draws discs as quads. The arguments are those of `discVertex`.
 * @param {string} depth
 * @param {boolean} hasNormals
 */
export const quadVertex = (depth, hasNormals = false) => discVertex(depth, hasNormals) + QUAD;

/**
 * The vertex shader that draws discs as point sprites. The arguments are those of `discVertex`.
 * @param {string} depth
 * @param {boolean} hasNormals
 */
export const spriteVertex = (depth, hasNormals = false) => discVertex(depth, hasNormals) + SPRITE;

export const SORTED_FRAGMENT = ALPHA + SORTED;
export const PEEL_FRAGMENT = ALPHA + PEEL;

/** Scales an image to the target. Row 0 is the top of the image. */
export const SCALE_FRAGMENT = `
uniform sampler2D image;
uniform vec2 target;
out vec4 colour;
void main() {
  vec2 position = vec2(gl_FragCoord.x, target.y - gl_FragCoord.y) / target;
  colour = vec4(texture(image, position).rgb, 1.0);
}
`;

/**
 * Composites a premultiplied image over a uniform background, applies the pixel filter, and scales the result to the
 * target. Row 0 is the top of the image. Beyond the border of the image, the nearest texel is repeated.
 */
export const OVER_BACKGROUND_FRAGMENT = `
#define POSITION vec2
${PIXEL_FILTER}
uniform sampler2D image;
uniform vec3 background;
uniform vec2 target;
out vec4 colour;

vec4 tap(vec2 position) {
  vec4 source = texture(image, position);
  return vec4(clamp(source.rgb + (1.0 - source.a) * background, 0.0, 1.0), 1.0);
}

void main() {
  vec2 texel = 1.0 / vec2(textureSize(image, 0));
  vec2 position = vec2(gl_FragCoord.x, target.y - gl_FragCoord.y) / target;
  colour = filtered(position, vec2(texel.x, 0.0), vec2(0.0, texel.y));
}
`;
