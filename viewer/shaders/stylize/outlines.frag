#version 330 core
#include "stylize/outlines.glsl"
