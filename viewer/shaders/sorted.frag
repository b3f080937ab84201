// Discs are drawn from the farthest to the nearest, and each is blended over the earlier ones.
#include "alpha.glsl.js"
#include "sorted.frag.js"
