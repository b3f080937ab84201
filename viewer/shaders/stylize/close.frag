#version 330 core
#include "stylize/gaps.glsl"
