// Returns the alpha of a disc at this fragment, and discards fragments outside the disc. The first two components of
// disc_centre are the disc's centre in window coordinates (pixels). The third component of disc_centre is 1 / radius^2
// in 1 / pixels^2.
float disc_alpha(vec3 disc_centre, float density) {
    vec2 d = disc_centre.xy - gl_FragCoord.xy;
    float alpha = density * (1.0 - dot(d, d) * disc_centre.z);
    if (!(alpha > 0.0)) discard;
    return alpha;
}
