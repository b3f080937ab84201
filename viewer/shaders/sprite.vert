#version 330 core
// Draws the bounding square of a disc as a point sprite. A sprite needs a quarter of the vertices of a quad, but
// drivers limit its size. The viewport extends past the image by `margin`, because OpenGL drops sprites whose centre is
// outside the viewport.
#include "disc.glsl"

uniform float margin;  // Width in pixels by which the viewport extends past the image.

void main() {
    write_outputs(2.0 * (disc.xy + margin) / (size + 2.0 * margin) - 1.0, gl_VertexID);
    gl_PointSize = disc.w * 2.00002 + 0.02;
}
