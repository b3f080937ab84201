#version 330 core
// Farthest first, to be blended over what is there already.

#include "alpha.glsl"

flat in vec3 place;
flat in vec4 tint;

out vec4 colour;

void main() {
    float alpha = alpha_here(place, tint.a);
    colour = vec4(tint.rgb * alpha, alpha);
}
