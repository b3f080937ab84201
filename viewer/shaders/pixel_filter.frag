#extension GL_ARB_derivative_control : enable
// Applies the pixel filter to an image that has the target's size.
#define POSITION ivec2
#include "pixel_filter.glsl.js"

uniform sampler2D image;

out vec4 colour;

// Returns a pixel of the image. Beyond the border, the nearest pixel is repeated.
vec4 tap(ivec2 pixel) { return texelFetch(image, clamp(pixel, ivec2(0), textureSize(image, 0) - 1), 0); }

#ifdef GL_ARB_derivative_control
// The four fragments of a quad share their taps, so each fragment reads four texels instead of nine. A derivative is
// the difference between the right and the left fragment of the quad, or between the upper and the lower one.
void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    ivec2 inner = 1 - 2 * (pixel & 1);  // The offsets of the quad's other column and other row.
    ivec2 outer = pixel - inner;
    vec4 middle = tap(pixel);
    vec4 row = filter_taps(middle, middle + float(inner.x) * dFdxFine(middle) + tap(ivec2(outer.x, pixel.y)));
    middle = tap(ivec2(pixel.x, outer.y));
    vec4 outer_row = filter_taps(middle, middle + float(inner.x) * dFdxFine(middle) + tap(outer));
    colour = filter_taps(row, row + float(inner.y) * dFdyFine(row) + outer_row);
}
#else
void main() { colour = filtered(ivec2(gl_FragCoord.xy), ivec2(1, 0), ivec2(0, 1)); }
#endif
