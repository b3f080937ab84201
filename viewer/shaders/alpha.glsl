// Returns the alpha of a disc at this fragment, and discards fragments outside the disc. `disc_centre` contains the
// disc's centre (x, y) in window coordinates, and 1 / radius^2. Lengths are in pixels.
float disc_alpha(vec3 disc_centre, float density) {
    vec2 d = disc_centre.xy - gl_FragCoord.xy;
    float alpha = density * (1.0 - dot(d, d) * disc_centre.z);
    if (!(alpha > 0.0)) discard;
    return alpha;
}
