// What every pass is told of a disc.

uniform vec2 size;     // of the picture, in pixels
uniform bool upright;  // row 0 of the picture at the top of the framebuffer, as it is seen; else at its bottom

in vec4 disc;
in vec4 paint;

flat out vec3 place;  // of the centre in the framebuffer, and 1 / rho^2
flat out vec4 tint;
flat out float rank;  // 1 for the first disc drawn

const float RANKS = 16777216.0;  // a depth buffer has 24 bits

// position: from -1 to 1 across the viewport, y downwards in the picture.
void pass_on(vec2 position, int number) {
    place = vec3(disc.x, upright ? size.y - disc.y : disc.y, disc.z);
    tint = paint;
    rank = float(number + 1);
    gl_Position = vec4(position.x, upright ? -position.y : position.y, 2.0 * (rank - 0.5) / RANKS - 1.0, 1.0);
}
