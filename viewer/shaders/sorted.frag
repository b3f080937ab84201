#version 330 core
// Outputs the premultiplied colour of a disc. Discs are drawn from the farthest to the nearest, and each is blended
// over the earlier ones.

#include "alpha.glsl"

flat in vec3 disc_centre;
flat in vec4 tint;

out vec4 colour;

void main() {
    float alpha = disc_alpha(disc_centre, tint.a);
    colour = vec4(tint.rgb * alpha, alpha);
}
