// Per-disc outputs that the vertex shaders of all geometry passes share.

uniform vec2 size;     // width and height of the image in pixels
uniform bool upright;  // true: image row 0 at the top of the framebuffer, as on screen; false: at its bottom

in vec4 disc;   // u, v, 1 / radius^2, radius; in pixels
in vec4 paint;  // red, green, blue, density

flat out vec3 disc_centre;  // centre in window coordinates, and 1 / radius^2
flat out vec4 tint;
flat out float rank;  // the first disc drawn has rank 1

const float RANKS = 16777216.0;  // number of depths that a 24-bit depth buffer distinguishes

// position is in [-1, 1] across the viewport, with y downwards in the image.
void write_outputs(vec2 position, int index) {
    disc_centre = vec3(disc.x, upright ? size.y - disc.y : disc.y, disc.z);
    tint = paint;
    rank = float(index + 1);
    gl_Position = vec4(position.x, upright ? -position.y : position.y, 2.0 * (rank - 0.5) / RANKS - 1.0, 1.0);
}
