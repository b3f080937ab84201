#version 330 core
// Composites a premultiplied image over a uniform background. Row 0 is the top row of the premultiplied image.

uniform sampler2D image;
uniform vec3 background;

out vec4 colour;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 source = texelFetch(image, ivec2(pixel.x, textureSize(image, 0).y - 1 - pixel.y), 0);
    colour = vec4(clamp(source.rgb + (1.0 - source.a) * background, 0.0, 1.0), source.a);
}
