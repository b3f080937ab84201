#version 330 core
// One pass of depth peeling (Everitt 2001). At each pixel, the depth test keeps the nearest disc behind the previous
// layer.

uniform sampler2D peeled_rank;  // Rank of the layer that the previous pass found.

#include "alpha.glsl"

flat in vec3 disc_centre;
flat in vec4 tint;
flat in float rank;

layout(location = 0) out vec4 layer;
layout(location = 1) out float layer_rank;

void main() {
    if (rank <= texelFetch(peeled_rank, ivec2(gl_FragCoord.xy), 0).r) discard;
    float alpha = disc_alpha(disc_centre, tint.a);
    layer = vec4(tint.rgb * alpha, alpha);
    layer_rank = rank;
}
