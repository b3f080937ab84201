#version 330 core
// What was composited from the front over what was from the back.

uniform sampler2D front;
uniform sampler2D back;

out vec4 colour;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 near = texelFetch(front, pixel, 0);
    colour = near + (1.0 - near.a) * texelFetch(back, pixel, 0);
}
