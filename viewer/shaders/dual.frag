#version 330 core
// The nearest and the farthest layer of what is left, in one pass (Bavoil and Myers 2008). All targets are blended by
// their maximum, so colours are shifted to be 0 or more. Ranks take the place of depths: no two points share one.

uniform sampler2D ends;    // minus the nearest rank that is left, and the farthest; (-NONE, -NONE) if none is
uniform sampler2D front;   // what is composited from the front, shifted
uniform float shift;
uniform bool front_only;

#include "alpha.glsl"

flat in vec3 place;
flat in vec4 tint;
flat in float rank;

layout(location = 0) out vec2 next_ends;
layout(location = 1) out vec4 next_front;
layout(location = 2) out vec4 back;

void main() {
    float alpha = alpha_here(place, tint.a);
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec2 found = texelFetch(ends, pixel, 0).rg;
    float nearest = -found.x, farthest = front_only ? NONE : found.y;
    next_ends = vec2(-NONE);
    next_front = texelFetch(front, pixel, 0);
    back = vec4(0.0);
    vec4 colour = vec4(tint.rgb + shift, 1.0) * alpha;
    if (rank == nearest) {
        next_front += (1.0 - next_front.a) * colour;
    } else if (rank == farthest) {
        back = colour;
    } else if (rank > nearest && rank < farthest) {
        next_ends = vec2(-rank, rank);
    }
}
