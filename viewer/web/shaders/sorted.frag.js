export const SORTED = /* glsl */ `
// Outputs the premultiplied colour of a disc. alpha.glsl.js must precede this code.

out vec4 colour;

void main() {
    float alpha = disc_alpha();
    colour = vec4(tint.rgb * alpha, alpha);
}
`;
