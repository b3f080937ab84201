#version 330 core
// The nearest and the farthest of what is left, in one pass (Bavoil and Myers 2008), by the maximum of what is drawn.
// Ranks take the place of depths: no two points share one, and it is enough to find them: layers.frag knows the rest.
#include "alpha.glsl"

uniform sampler2D ends;  // minus the nearest rank of the pass before, and the farthest; (-NONE, -NONE) where none was
uniform bool front_only;

flat in vec3 place;
flat in vec4 tint;
flat in float rank;

out vec2 next_ends;

void main() {
    vec2 found = texelFetch(ends, ivec2(gl_FragCoord.xy), 0).rg;
    if (rank <= -found.x || rank >= (front_only ? NONE : found.y)) discard;
    alpha_here(place, tint.a);
    next_ends = vec2(-rank, rank);
}
