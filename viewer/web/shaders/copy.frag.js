export const COPY_FRAGMENT = /* glsl */ `
// Copies an image that has the target's size. The blend mode determines how it is combined with the target's content.

uniform sampler2D image;

out vec4 colour;

void main() { colour = texelFetch(image, ivec2(gl_FragCoord.xy), 0); }
`;
