export const ALPHA = /* glsl */ `
// The inputs that the fragment shaders of all geometry passes share.
flat in vec3 disc_centre;  // Centre in window coordinates, and 1 / radius^2, with lengths in pixels.
flat in vec4 tint;         // Red, green, blue and density.
flat in float rank;        // Position in drawing order, counted from 1.

// Returns the alpha of the disc at this fragment, and discards fragments outside the disc.
float disc_alpha() {
    vec2 d = disc_centre.xy - gl_FragCoord.xy;
    float alpha = tint.a * (1.0 - dot(d, d) * disc_centre.z);
    if (!(alpha > 0.0)) discard;
    return alpha;
}
`;
