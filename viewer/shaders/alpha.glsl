// The alpha of a point at this pixel; discards the pixel where the point does not reach.
float alpha_here(vec3 place, float density) {
    vec2 d = place.xy - gl_FragCoord.xy;
    float alpha = density * (1.0 - dot(d, d) * place.z);
    if (!(alpha > 0.0)) discard;
    return alpha;
}
