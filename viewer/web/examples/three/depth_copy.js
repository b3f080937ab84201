import * as THREE from "three";

const VERTEX = `
varying vec2 at;
void main() {
  at = uv;
  gl_Position = vec4(position.xy, 0.0, 1.0);
}
`;
const FRAGMENT = `
uniform sampler2D image;
uniform sampler2D depth;
varying vec2 at;
void main() {
  gl_FragColor = texture2D(image, at);
  gl_FragDepth = texture2D(depth, at).r;
  #include <colorspace_fragment>
}
`;

/** Copies the colour and the depth of a render target to the canvas. */
export class DepthCopy {
  /** @param {THREE.WebGLRenderTarget} target */
  constructor(target) {
    const uniforms = { image: { value: target.texture }, depth: { value: target.depthTexture } };
    const material = new THREE.ShaderMaterial({
      uniforms,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      depthFunc: THREE.AlwaysDepth,
    });
    this.scene = new THREE.Scene();
    const square = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material);
    square.frustumCulled = false;
    this.scene.add(square);
    this.camera = new THREE.Camera();
  }

  /** @param {THREE.WebGLRenderer} renderer */
  draw(renderer) {
    renderer.render(this.scene, this.camera);
  }
}
