#version 330 core
#include "stylize/lines.glsl"
#include "stylize/shading.glsl"
#include "stylize/picture.glsl"
