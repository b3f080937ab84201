#include "disc.glsl"
#include "sprite.vert.js"
