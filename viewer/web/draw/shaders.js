/**
 * GLSL ES 3.00 shaders. They use the same formulas as the shaders in viewer/shaders/, which draw scenes in the viewer's
 * window.
 */

/** Width in texels of the textures that store arrays. */
export const TEXELS_PER_ROW = 4096;
/** Largest number of source views that are blended. */
export const MAX_BLENDED = 64;

/** The first lines of every shader. */
export const HEADER = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;
precision highp isampler2D;
precision highp sampler2DArray;
#define TEXELS_PER_ROW ${TEXELS_PER_ROW}
`;

/** Draws one triangle that covers the viewport. */
export const FULL_SCREEN_VERTEX = `${HEADER}
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }
`;

/**
 * Multiplies the factors of a cloud by the basis of its spherical harmonics. Each fragment computes 8 of a point's 48
 * coefficients and packs them as float16 values. Block b of the target contains the coefficients `8 * b` to `8 * b +
 * 7`.
 */
export const HARMONICS_FRAGMENT = `${HEADER}
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
export const SHADE_VERTEX = `${HEADER}
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

uniform vec3 intrinsics_x;
uniform vec3 intrinsics_y;
uniform vec3 rotation_x;
uniform vec3 rotation_y;
uniform vec3 rotation_z;
uniform vec3 translation;
uniform vec3 camera_centre;
uniform float near;
const float FADE_SHARE = 0.5;  // Depth over which points fade, as a fraction of the depth of the near plane.

uniform int blended_layers[${MAX_BLENDED}];
uniform float view_weights[${MAX_BLENDED}];
uniform int blended_count;
uniform float sh_range;
uniform float sh_base;

in uint point;
out vec4 disc;   // Centre (u, v) in pixels, depth in world units, and radius rho in pixels.
out vec4 paint;  // Red, green, blue and density.

ivec2 at(int texel) { return ivec2(texel & (TEXELS_PER_ROW - 1), texel / TEXELS_PER_ROW); }

float affine(vec3 row, vec3 p, float offset) { return row.x * p.x + row.y * p.y + row.z * p.z + offset; }

void read_block(int index, int block, out vec4 first, out vec4 second) {
  ivec2 texel = at(index);
  uvec4 packed = texelFetch(harmonics, ivec2(texel.x, texel.y + block * block_rows), 0);
  first = vec4(unpackHalf2x16(packed.x), unpackHalf2x16(packed.y));
  second = vec4(unpackHalf2x16(packed.z), unpackHalf2x16(packed.w));
}

float channel(int index, int block, mat4 basis) {
  vec4 a, b, c, d;
  read_block(index, block, a, b);
  read_block(index, block + 1, c, d);
  return dot(a, basis[0]) + dot(b, basis[1]) + dot(c, basis[2]) + dot(d, basis[3]);
}

vec3 spherical_harmonics(int index, vec3 d) {
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
  return vec3(channel(index, 0, basis), channel(index, 2, basis), channel(index, 4, basis));
}

vec3 blend_source_views(int index, int cloud) {
  float factor = cloud == 1 && has_shadow ? float(texelFetch(shadow, at(index - background_first), 0).r) / 128.0 : 1.0;
  bool has_factor = cloud == 1 && has_shadow;
  vec3 sum = vec3(0.0), plain_sum = vec3(0.0);
  float total = 0.0, plain_total = 0.0;
  for (int k = 0; k < blended_count; ++k) {
    vec4 texel = texelFetch(views, ivec3(at(index), blended_layers[k]), 0);
    vec3 colour = texel.rgb;
    if (has_factor) colour = min(floor(colour * 255.0 * factor + 0.5), 255.0) / 255.0;
    float code = texel.a * 255.0;
    float weight = code > 0.5 ? view_weights[k] * 1024.0 * exp2((1.0 - code) / weight_steps[cloud]) : 0.0;
    sum += weight * colour;
    plain_sum += view_weights[k] * colour;
    plain_total += view_weights[k];
    total += weight;
  }
  return total > 0.0 ? sum / max(total, 1e-30) : plain_sum / max(plain_total, 1e-30);
}

void main() {
  int index = int(point);
  int cloud = index < background_first ? 0 : 1;
  vec3 world = texelFetch(xyz, at(index), 0).xyz;
  uint size = texelFetch(sizes, at(index), 0).r;
  vec4 scale = radius_density[cloud];
  float code = float(size & 0xffffu);
  float radius = code > 0.5 ? scale.x * exp2((code - 1.0) / scale.y) : 0.0;
  float density = min(float(size >> 16u) / scale.z, 1.0);
  vec3 p = vec3(affine(rotation_x, world, translation.x), affine(rotation_y, world, translation.y),
                affine(rotation_z, world, translation.z));
  float rho = intrinsics_y.y * radius / p.z;
  // Points fade at the near plane (fourd/rendering/ops/play/near_fade.py).
  density *= clamp((p.z - near) / (FADE_SHARE * near), 0.0, 1.0);
  gl_Position = vec4(0.0);
  gl_PointSize = 1.0;
  if (!(p.z >= near && density > 0.0 && rho > 0.0 && rho < 1e18)) {
    disc = vec4(-1.0, -1.0, near, 0.0);
    paint = vec4(0.0);
    return;
  }
  disc = vec4((intrinsics_x.x * p.x + intrinsics_x.y * p.y) / p.z + intrinsics_x.z,
              (intrinsics_y.x * p.x + intrinsics_y.y * p.y) / p.z + intrinsics_y.z, p.z, rho);
  vec3 ray = world - camera_centre;
  vec3 direction = ray / max(length(ray), 1e-12);
  vec3 view_dependent = sh_base + sh_range * tanh(spherical_harmonics(index, direction));
  paint = vec4(blend_source_views(index, cloud) + view_dependent, density);
}
`;

/** Outputs 0. This shader exists only because WebGL requires a fragment shader, even though transform feedback discards
 * all fragments. */
export const NO_FRAGMENT = `${HEADER}
out vec4 nothing;
void main() { nothing = vec4(0.0); }
`;

/** GLSL expression of a disc's depth for depth peeling, which peels discs by their rank. */
export const RANK_DEPTH = "2.0 * (rank - 0.5) / 16777216.0 - 1.0";
/** GLSL expression of a disc's depth for passes that neither test nor store depths. */
export const NO_DEPTH = "0.0";

/** @param {boolean} hasNormals */
const sharedDiscVertex = (hasNormals) => `
uniform vec2 size;
in vec4 disc;
in vec4 paint;
${hasNormals ? "in vec4 normal;\nflat out vec4 disc_normal;" : ""}
flat out vec3 disc_centre;
flat out float disc_depth;
flat out vec4 tint;
flat out float rank;

void pass_on(int index) {
  disc_centre = vec3(disc.xy, disc.w > 0.0 ? 1.0 / (disc.w * disc.w) : 1.0);
  disc_depth = disc.z;
  tint = paint;
  rank = float(index + 1);
  ${hasNormals ? "disc_normal = normal;" : ""}
}
`;

/**
 * Draws the bounding square of a disc as two triangles. Row 0 of the image is at the bottom of the framebuffer.
 * @param {string} depth GLSL expression of the depth in normalised device coordinates.
 * @param {boolean} hasNormals Whether discs have a normal and a weight, which fragments read as `disc_normal`.
 */
export function quadVertex(depth, hasNormals = false) {
  return `${HEADER}
uniform vec2 depth_range;
${sharedDiscVertex(hasNormals)}
void main() {
  pass_on(gl_InstanceID);
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  vec2 pixel = clamp(disc.xy + corner * (disc.w * 1.00001 + 0.001), vec2(-16.0), size + 16.0);
  gl_Position = vec4(2.0 * pixel / size - 1.0, ${depth}, 1.0);
}
`;
}

/**
 * Draws the bounding square of a disc as a point sprite. The viewport extends past the image by `margin`.
 * @param {string} depth GLSL expression of the depth in normalised device coordinates.
 * @param {boolean} hasNormals
 */
export function spriteVertex(depth, hasNormals = false) {
  return `${HEADER}
uniform vec2 depth_range;
uniform float margin;
${sharedDiscVertex(hasNormals)}
void main() {
  pass_on(gl_VertexID);
  gl_Position = vec4(2.0 * (disc.xy + margin) / (size + 2.0 * margin) - 1.0, ${depth}, 1.0);
  gl_PointSize = disc.w * 2.00002 + 0.02;
}
`;
}

/** Declares the inputs of a disc's fragments, and computes their alpha. */
export const DISC = `
flat in vec3 disc_centre;
flat in float disc_depth;
flat in vec4 tint;
flat in float rank;

float disc_alpha() {
  vec2 d = disc_centre.xy - gl_FragCoord.xy;
  float alpha = tint.a * (1.0 - dot(d, d) * disc_centre.z);
  if (!(alpha > 0.0)) discard;
  return alpha;
}
`;

/** Outputs the premultiplied colour of a disc. */
export const SORTED_FRAGMENT = `${HEADER}${DISC}
out vec4 colour;
void main() {
  float alpha = disc_alpha();
  colour = vec4(tint.rgb * alpha, alpha);
}
`;

/** One pass of depth peeling (Everitt 2001). The depth test keeps the nearest disc behind the previous layer. */
export const PEEL_FRAGMENT = `${HEADER}
uniform sampler2D peeled_rank;
${DISC}
layout(location = 0) out vec4 layer;
layout(location = 1) out float layer_rank;
void main() {
  if (rank <= texelFetch(peeled_rank, ivec2(gl_FragCoord.xy), 0).r) discard;
  float alpha = disc_alpha();
  layer = vec4(tint.rgb * alpha, alpha);
  layer_rank = rank;
}
`;

/** Copies an image that has the target's size. */
export const COPY_FRAGMENT = `${HEADER}
uniform sampler2D image;
out vec4 colour;
void main() { colour = texelFetch(image, ivec2(gl_FragCoord.xy), 0); }
`;

/** Scales an image to the target. Row 0 is the top of the image. */
export const SCALE_FRAGMENT = `${HEADER}
uniform sampler2D image;
uniform vec2 target;
out vec4 colour;
void main() {
  vec2 position = vec2(gl_FragCoord.x, target.y - gl_FragCoord.y) / target;
  colour = vec4(texture(image, position).rgb, 1.0);
}
`;

/**
 * The pixel filter, which is a weighted mean of 3 x 3 values. A shader must define `vec4 tap(T)` before this code. The
 * arguments `right` and `down` of the functions are steps of one pixel.
 * @param {"vec2" | "ivec2"} type T, the type of positions.
 */
export const pixelFilter = (type) => `
uniform float pixel_filter;  // Weight of each neighbour in the 3-tap filters along rows and columns; 0 for none.

vec4 filter_row(${type} position, ${type} right) {
  return pixel_filter * (tap(position - right) + tap(position + right)) + (1.0 - 2.0 * pixel_filter) * tap(position);
}

vec4 filtered(${type} position, ${type} right, ${type} down) {
  if (pixel_filter == 0.0) return tap(position);
  vec4 sides = filter_row(position - down, right) + filter_row(position + down, right);
  return pixel_filter * sides + (1.0 - 2.0 * pixel_filter) * filter_row(position, right);
}
`;

/**
 * Composites a premultiplied image over a uniform background, applies the pixel filter, and scales the result to the
 * target. Row 0 is the top of the image. Beyond the border of the image, the nearest texel is repeated.
 */
export const OVER_BACKGROUND_FRAGMENT = `${HEADER}
uniform sampler2D image;
uniform vec3 background;
uniform vec2 target;
out vec4 colour;

vec4 tap(vec2 position) {
  vec4 source = texture(image, position);
  return vec4(clamp(source.rgb + (1.0 - source.a) * background, 0.0, 1.0), 1.0);
}
${pixelFilter("vec2")}
void main() {
  vec2 texel = 1.0 / vec2(textureSize(image, 0));
  vec2 position = vec2(gl_FragCoord.x, target.y - gl_FragCoord.y) / target;
  colour = filtered(position, vec2(texel.x, 0.0), vec2(0.0, texel.y));
}
`;
