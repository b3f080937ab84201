// Composites a premultiplied image over a uniform background. Row 0 of the input is the top of the image.

uniform sampler2D image;
uniform vec3 background;
uniform bool is_picture;  // Whether the result is clamped to [0, 1].

out vec4 colour;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    pixel.y = textureSize(image, 0).y - 1 - pixel.y;
    vec4 source = texelFetch(image, pixel, 0);
    vec3 sum = source.rgb + (1.0 - source.a) * background;
    colour = vec4(is_picture ? clamp(sum, 0.0, 1.0) : sum, source.a);
}
