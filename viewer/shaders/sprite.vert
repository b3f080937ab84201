#version 330 core
// A disc's square of pixels as a point sprite: a quarter of the vertices, but drivers bound its size. The viewport
// reaches over the picture's edges by `margin`, since sprites whose centre lies outside of it are dropped.
#include "disc.glsl"

uniform float margin;  // in pixels

void main() {
    pass_on(2.0 * (disc.xy + margin) / (size + 2.0 * margin) - 1.0, gl_VertexID);
    gl_PointSize = disc.w * 2.00002 + 0.02;
}
