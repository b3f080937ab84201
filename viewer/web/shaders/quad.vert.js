export const QUAD = /* glsl */ `
// Draws the bounding square of a disc as two triangles. Discs can have any size and position. Code that declares the
// disc, the size of the image and write_outputs() must precede this code.

void main() {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    vec2 pixel = disc.xy + corner * (disc.w * 1.00001 + 0.001);
    // Huge coordinates are clamped, because rasterizers are not precise far outside the image. This does not move
    // corners inside the image.
    pixel = clamp(pixel, vec2(-16.0), size + 16.0);
    write_outputs(2.0 * pixel / size - 1.0, gl_InstanceID);
}
`;
