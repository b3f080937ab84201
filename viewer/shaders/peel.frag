#version 330 core
// The nearest point behind the layer before: the depth test chooses among those that are left (Everitt 2001).

uniform sampler2D peeled;  // rank of the layer before

#include "alpha.glsl"

flat in vec3 place;
flat in vec4 tint;
flat in float rank;

layout(location = 0) out vec4 layer;
layout(location = 1) out float taken;

void main() {
    if (rank <= texelFetch(peeled, ivec2(gl_FragCoord.xy), 0).r) discard;
    float alpha = alpha_here(place, tint.a);
    layer = vec4(tint.rgb * alpha, alpha);
    taken = rank;
}
