#include "stylize/lines.glsl.js"
#include "stylize/shading.glsl.js"
#include "stylize/picture.frag.js"
