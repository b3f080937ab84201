#version 330 core
// Composites a premultiplied image over a uniform background, and applies the pixel filter. Row 0 of the input is the
// top of the image.

uniform sampler2D image;
uniform vec3 background;
uniform float pixel_filter;  // Weight of each neighbour in the 3-tap filters along rows and columns; 0 for none.
uniform bool is_picture;     // Whether the result is clamped to [0, 1].

out vec4 colour;

// Returns the colour of a pixel, composited over the background. Beyond the border, the nearest pixel is repeated.
vec4 over_background(ivec2 pixel) {
    vec4 source = texelFetch(image, clamp(pixel, ivec2(0), textureSize(image, 0) - 1), 0);
    vec3 sum = source.rgb + (1.0 - source.a) * background;
    return vec4(is_picture ? clamp(sum, 0.0, 1.0) : sum, source.a);
}

vec4 filter_row(ivec2 pixel) {
    vec4 sides = over_background(pixel - ivec2(1, 0)) + over_background(pixel + ivec2(1, 0));
    return pixel_filter * sides + (1.0 - 2.0 * pixel_filter) * over_background(pixel);
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    pixel.y = textureSize(image, 0).y - 1 - pixel.y;
    if (pixel_filter == 0.0) {
        colour = over_background(pixel);
        return;
    }
    vec4 sides = filter_row(pixel - ivec2(0, 1)) + filter_row(pixel + ivec2(0, 1));
    colour = pixel_filter * sides + (1.0 - 2.0 * pixel_filter) * filter_row(pixel);
}
