#version 330 core
// A picture, whose row 0 is its top, over the background.

uniform sampler2D picture;
uniform vec3 background;

out vec4 colour;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 seen = texelFetch(picture, ivec2(pixel.x, textureSize(picture, 0).y - 1 - pixel.y), 0);
    colour = vec4(clamp(seen.rgb + (1.0 - seen.a) * background, 0.0, 1.0), seen.a);
}
