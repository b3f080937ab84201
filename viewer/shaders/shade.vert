#include "camera.glsl.js"
#include "points.glsl.js"
#include "stylize/octahedral.glsl.js"
// Projects and shades one point. Transform feedback stores the result, once per image, for all geometry passes.

uniform sampler2D xyz;            // The textures xyz, radius and density have one texel per point.
uniform sampler2D radius;
uniform sampler2D density;
uniform sampler2D sh;             // Twelve texels per point: 16 coefficients each for red, green and blue.
uniform sampler2D blend_weights;  // One texel per point and source view.
uniform sampler2D rgb;            // One texel per point and source view.
uniform int views;                // Number of source views.
uniform int dynamic_count;        // Number of dynamic points, which are stored first.
uniform int gap;                  // Number of unused slots between the dynamic points and the static background points.

uniform int blended_views[MAX_BLENDED];  // Indices of the source views to blend.

uniform sampler2D normals;  // One texel per point: an octahedral normal in world axes. Not read for COLOURS.
uniform int painted;        // The quantity that the discs show: COLOURS, NORMALS or DEPTHS.
uniform float depth_unit;   // Depths are written as multiples of this length, which is in world units.

const int COLOURS = 0;
const int NORMALS = 1;  // The normal times front_weight.
const int DEPTHS = 2;   // The depth times front_weight, and front_weight itself.

in uint point;

out vec4 disc;   // Centre (u, v), 1 / rho^2 and the radius rho, with lengths in pixels.
out vec4 paint;  // Red, green and blue (or the values for NORMALS or DEPTHS), and the density.

int slot;  // Index of the point in the textures.

mat4 sh_coefficients(int channel) {
    int first = 12 * slot + 4 * channel;
    return mat4(texelFetch(sh, at(first), 0), texelFetch(sh, at(first + 1), 0), texelFetch(sh, at(first + 2), 0),
                texelFetch(sh, at(first + 3), 0));
}

vec4 source_view(int k) {
    ivec2 texel = at(slot * views + blended_views[k]);
    return vec4(texelFetch(rgb, texel, 0).rgb, texelFetch(blend_weights, texel, 0).r);
}

void main() {
    slot = int(point) < dynamic_count ? int(point) : int(point) + gap;
    vec3 world = texelFetch(xyz, at(slot), 0).xyz, p = to_camera(world);
    float rho, visible_density = min(texelFetch(density, at(slot), 0).r, 1.0);
    vec2 centre;
    if (!project(p, texelFetch(radius, at(slot), 0).r, visible_density, centre, rho)) {
        disc = vec4(-1.0, -1.0, 1.0, 0.0);
        paint = vec4(0.0);
        return;
    }
    disc = vec4(centre, 1.0 / (rho * rho), rho);
    paint.a = visible_density;
    if (painted == COLOURS) {
        paint.rgb = colour_of(world);
        return;
    }
    vec3 normal = turn_to_camera(decode_octahedral(texelFetch(normals, at(slot), 0).rg));
    float weight = front_weight(normal, p);
    paint.rgb = painted == NORMALS ? weight * normal : vec3(weight * p.z / depth_unit, weight, 0.0);
}
