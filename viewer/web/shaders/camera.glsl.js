export const CAMERA = /* glsl */ `
// The camera of an image, and the texels of points.

uniform vec3 rotation_x;  // The rows of R_camera_world.
uniform vec3 rotation_y;
uniform vec3 rotation_z;
uniform vec3 translation;

// Returns the position of a texel in a texture that stores an array.
ivec2 at(int texel) { return ivec2(texel & (TEXELS_PER_ROW - 1), texel / TEXELS_PER_ROW); }

float affine(vec3 row, vec3 p, float offset) { return row.x * p.x + row.y * p.y + row.z * p.z + offset; }

// Returns a position in camera axes.
vec3 to_camera(vec3 world) {
    return vec3(affine(rotation_x, world, translation.x), affine(rotation_y, world, translation.y),
                affine(rotation_z, world, translation.z));
}

// Returns a direction in camera axes.
vec3 turn_to_camera(vec3 direction) {
    return vec3(dot(rotation_x, direction), dot(rotation_y, direction), dot(rotation_z, direction));
}
`;
