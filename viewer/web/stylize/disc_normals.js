import { bindTexture, makeProgram } from "../draw/gl.js";
import { NO_FRAGMENT, quadVertex, spriteVertex } from "../draw/shaders.js";
import { ALPHA } from "../shaders/alpha.glsl.js";
import { CAMERA } from "../shaders/camera.glsl.js";
import { OCTAHEDRAL } from "../shaders/stylize/octahedral.glsl.js";
/** @typedef {import("../draw/discs.js").Discs} Discs */
/** @typedef {import("../scene/manifest.js").Camera} Camera */

const BYTES_PER_NORMAL = 16;

/** Rotates the normal of one point to camera axes, and computes the weight of the point. */
const NORMAL_VERTEX = `${CAMERA}${OCTAHEDRAL}
uniform sampler2D normals;  // One texel per point: an octahedral normal in world axes.
uniform sampler2D xyz;
in uint point;
out vec4 normal;  // The normal times the weight, and the weight itself.

void main() {
  ivec2 texel = at(int(point));
  vec3 turned = turn_to_camera(decode_octahedral(texelFetch(normals, texel, 0).rg));
  float weight = front_weight(turned, to_camera(texelFetch(xyz, texel, 0).xyz));
  normal = vec4(weight * turned, weight);
  gl_Position = vec4(0.0);
  gl_PointSize = 1.0;
}
`;

/** Outputs the colour, the normal, the depth and the weight of a disc, premultiplied by alpha. */
export const SURFACE_FRAGMENT = `${ALPHA}
flat in float disc_depth;
flat in vec4 disc_normal;
uniform float depth_unit;  // Unit of depths, in world units. It brings depths into the range of float16.
layout(location = 0) out vec4 colour;
layout(location = 1) out vec4 weighted_normal;
layout(location = 2) out vec4 weighted_depth;

void main() {
  float alpha = disc_alpha();
  colour = vec4(tint.rgb * alpha, alpha);
  weighted_normal = vec4(disc_normal.xyz * alpha, alpha);
  weighted_depth = vec4(disc_depth / depth_unit, 1.0, 0.0, 0.0) * (disc_normal.w * alpha);
  weighted_depth.a = alpha;
}
`;

/** The normals of projected points, in the same order as the discs. */
export class DiscNormals {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Discs} discs
   */
  constructor(gl, discs) {
    this.gl = gl;
    this.discs = discs;
    const options = { attributes: ["point"], varyings: ["normal"] };
    this.program = makeProgram(gl, NORMAL_VERTEX, NO_FRAGMENT, options);
    this.feedback = gl.createTransformFeedback();
    this.buffer = gl.createBuffer();
    this.capacity = 0;
    this.arrays = { sprite: gl.createVertexArray(), quad: gl.createVertexArray() };
    this.#makeArrays();
  }

  /**
   * Returns the programs of a pass that draws discs with normals.
   * @param {string} fragment
   * @param {string} depth GLSL expression of the discs' depth in normalised device coordinates.
   * @returns {import("../draw/discs.js").DiscPass}
   */
  makePass(fragment, depth) {
    const options = { attributes: ["disc", "paint", "normal"] };
    const sprite = makeProgram(this.gl, spriteVertex(depth, true), fragment, options);
    return { sprite, quad: makeProgram(this.gl, quadVertex(depth, true), fragment, options), arrays: this.arrays };
  }

  /**
   * Rotates the normals of the points that `discs` projected last to camera axes.
   * @param {WebGLTexture} normals
   * @param {WebGLTexture} xyz
   * @param {Camera} camera
   */
  project(normals, xyz, { rotation, translation }) {
    const { gl, program } = this;
    const { count } = this.discs;
    if (count === 0) return;
    this.#reserve(count);
    program.use();
    bindTexture(gl, 0, normals);
    bindTexture(gl, 1, xyz);
    program.integers({ normals: 0, xyz: 1 });
    program.floats({ rotation_x: rotation.slice(0, 3), rotation_y: rotation.slice(3, 6), rotation_z: rotation.slice(6, 9) });
    program.floats({ translation });
    this.discs.transform(this.feedback, this.buffer);
  }

  release() {
    const { gl } = this;
    gl.deleteBuffer(this.buffer);
    for (const array of Object.values(this.arrays)) gl.deleteVertexArray(array);
    gl.deleteTransformFeedback(this.feedback);
    this.program.release();
  }

  /** @param {number} count */
  #reserve(count) {
    if (count <= this.capacity) return;
    const { gl } = this;
    this.capacity = Math.ceil(1.25 * count);
    gl.bindVertexArray(null);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, BYTES_PER_NORMAL * this.capacity, gl.DYNAMIC_COPY);
    gl.bindBuffer(gl.ARRAY_BUFFER, null);
  }

  #makeArrays() {
    const { gl } = this;
    for (const [array, divisor] of /** @type {const} */ ([[this.arrays.quad, 1], [this.arrays.sprite, 0]])) {
      this.discs.describe(array, divisor);
      gl.bindVertexArray(array);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
      gl.enableVertexAttribArray(2);
      gl.vertexAttribPointer(2, 4, gl.FLOAT, false, BYTES_PER_NORMAL, 0);
      gl.vertexAttribDivisor(2, divisor);
    }
    gl.bindVertexArray(null);
    gl.bindBuffer(gl.ARRAY_BUFFER, null);
  }
}
