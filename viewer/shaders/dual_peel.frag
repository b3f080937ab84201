// Geometry pass of dual depth peeling (Bavoil and Myers 2008). The rank of a disc is its position in depth order,
// nearest first. Each fragment outputs two values: minus its rank, and its rank. Max blending keeps the maximum of each
// value, so one pass finds both the nearest and the farthest remaining layer of each pixel. Ranks replace depths,
// because two discs can have the same depth but not the same rank.
#include "alpha.glsl.js"

// The result of the previous pass in each pixel: minus the rank of the nearest layer, and the rank of the farthest
// layer. In pixels without layers, both values are -NONE.
uniform sampler2D bounds;
uniform bool front_only;

out vec2 next_bounds;

void main() {
    vec2 previous = texelFetch(bounds, ivec2(gl_FragCoord.xy), 0).rg;
    if (rank <= -previous.x || rank >= (front_only ? NONE : previous.y)) discard;
    disc_alpha();
    next_bounds = vec2(-rank, rank);
}
