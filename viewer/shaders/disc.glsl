// The per-disc outputs of the vertex shaders of all geometry passes.

uniform vec2 size;     // Width and height of the image in pixels.
uniform bool upright;  // True: image row 0 is at the top of the framebuffer, as on screen. False: at the bottom.

in vec4 disc;   // Centre (u, v), 1 / radius^2 and radius, with lengths in pixels.
in vec4 paint;  // Red, green, blue and density.

flat out vec3 disc_centre;  // Centre in window coordinates, and 1 / radius^2.
flat out vec4 tint;
flat out float rank;  // Position in drawing order, counted from 1.

const float RANKS = 16777216.0;  // Number of distinct values in a 24-bit depth buffer.

// Writes all outputs of one vertex. `position` ranges from -1 to 1 across the viewport, and its y axis points down in
// the image.
void write_outputs(vec2 position, int index) {
    disc_centre = vec3(disc.x, upright ? size.y - disc.y : disc.y, disc.z);
    tint = paint;
    rank = float(index + 1);
    gl_Position = vec4(position.x, upright ? -position.y : position.y, 2.0 * (rank - 0.5) / RANKS - 1.0, 1.0);
}
