#include "alpha.glsl.js"
#include "peel.frag.js"
