#include "disc.glsl"
#include "quad.vert.js"
