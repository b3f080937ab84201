export const PEEL = /* glsl */ `
// One pass of depth peeling (Everitt 2001). At each pixel, the depth test keeps the nearest disc behind the previous
// layer. alpha.glsl.js must precede this code.

uniform sampler2D peeled_rank;  // Rank of the layer that the previous pass found.

layout(location = 0) out vec4 layer;
layout(location = 1) out float layer_rank;

void main() {
    if (rank <= texelFetch(peeled_rank, ivec2(gl_FragCoord.xy), 0).r) discard;
    float alpha = disc_alpha();
    layer = vec4(tint.rgb * alpha, alpha);
    layer_rank = rank;
}
`;
