#version 330 core
// Copies an image of the same size; the blend function of the pass decides how.

uniform sampler2D image;

out vec4 colour;

void main() { colour = texelFetch(image, ivec2(gl_FragCoord.xy), 0); }
