export const OCTAHEDRAL = /* glsl */ `
// Decodes normals, as decode_octahedral in fourd/scene/styles/normals.py does, and computes the weights of points, as
// front_weight in fourd/rendering/ops/stylize/reference.py does.

// Returns the unit normal of a texel, whose channels are bytes / 255.
vec3 decode_octahedral(vec2 texel) {
    vec2 plane = (texel * 255.0 - 128.0) / 127.0;
    float z = 1.0 - abs(plane.x) - abs(plane.y), folded = max(-z, 0.0);
    plane -= folded * vec2(plane.x > 0.0 ? 1.0 : -1.0, plane.y > 0.0 ? 1.0 : -1.0);
    return vec3(plane, z) / max(length(vec3(plane, z)), 1e-12);
}

const float BACK_WEIGHT = 0.1;

// The depth and the normal of the visible surface are weighted means over points. Returns the factor by which the
// weight of a point is multiplied. The factor is larger for points that face the camera. normal and position are in
// camera axes.
float front_weight(vec3 normal, vec3 position) {
    float cosine = -dot(normal, position) / max(length(position), 1e-10);
    return BACK_WEIGHT + (1.0 - BACK_WEIGHT) * clamp(0.5 + 5.0 * cosine, 0.0, 1.0);
}
`;
