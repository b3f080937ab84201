// Composites the two layers that a dual peeling pass has found: the nearer one behind `front`, and the farther one in
// front of `back`. The rank of a disc is its position in depth order, counted from 1, nearest first.

uniform sampler2D bounds;  // Minus the rank of the nearer layer, and the rank of the farther layer (dual_peel.frag).
uniform sampler2D discs;   // Two texels per disc, in order of rank.
uniform sampler2D front;
uniform sampler2D back;
uniform bool front_only;

layout(location = 0) out vec4 next_front;
layout(location = 1) out vec4 next_back;

// Returns the premultiplied colour of the disc with this rank at the fragment.
vec4 layer(float rank) {
    int texel = 2 * (int(rank) - 1);
    ivec2 at = ivec2(texel & (TEXELS_PER_ROW - 1), texel / TEXELS_PER_ROW);
    vec4 disc = texelFetch(discs, at, 0), paint = texelFetch(discs, at + ivec2(1, 0), 0);
    vec2 d = disc.xy - gl_FragCoord.xy;
    return vec4(paint.rgb, 1.0) * paint.a * (1.0 - dot(d, d) * disc.z);
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec2 found = texelFetch(bounds, pixel, 0).rg;
    next_front = texelFetch(front, pixel, 0);
    next_back = texelFetch(back, pixel, 0);
    if (found.x == -NONE) return;
    next_front += (1.0 - next_front.a) * layer(-found.x);
    if (front_only || found.y == -found.x) return;
    vec4 farther = layer(found.y);
    next_back = farther + (1.0 - farther.a) * next_back;
}
