export const SPRITE = /* glsl */ `
// Draws the bounding square of a disc as a point sprite. A sprite needs a quarter of the vertices of a quad, but
// drivers limit its size. The viewport extends past the image by the margin, because OpenGL and WebGL drop sprites whose
// centre is outside the viewport. Code that declares the disc, the size of the image and write_outputs() must precede
// this code.

uniform float margin;  // Width in pixels by which the viewport extends past the image.

void main() {
    write_outputs(2.0 * (disc.xy + margin) / (size + 2.0 * margin) - 1.0, gl_VertexID);
    gl_PointSize = disc.w * 2.00002 + 0.02;
}
`;
