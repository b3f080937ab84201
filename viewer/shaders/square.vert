#version 330 core
// A disc's square of pixels as two triangles: of any size, and wherever its centre lies.
#include "disc.glsl"

void main() {
    vec2 towards = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    vec2 pixel = disc.xy + towards * (disc.w * 1.00001 + 0.001);
    // What is out of sight need not be exact, and keeps rasterisers away from huge numbers.
    pixel = clamp(pixel, vec2(-16.0), size + 16.0);
    pass_on(2.0 * pixel / size - 1.0, gl_InstanceID);
}
