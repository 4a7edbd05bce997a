#version 430
// The input of the network that writes pixels: footprints, 9 channels, with light compressed in OIDN's unit, albedo and normal
// in [0, 1]. Where one frame has seen a pixel, and more have seen those around it, some of the kernels' picture stands in for
// light, the less noise there is, or history stays, the less (EVEN, ops.evened, models.hybrid).
// One invocation per pixel of the padded result, which is zero beyond the image.
#pragma constants EVEN MIX_SEEN_ONCE PIXELS_LIGHT PIXELS_UNIT
#pragma parameters ivec2 image_size
#include "around.glsl"
#include "activations.glsl"
#include "lift.glsl"

#pragma reads vec4 shown           // [3, image_size] rgb, frames · albedo, trust · normal, stays
#pragma reads vec4 denoised        // [image_size] the kernels' picture
#pragma reads vec4 cells           // of `hybrid/cells`
#pragma reads float statistics     // [2] exposure, ·
#pragma reads float level          // [2] of `hybrid/level`
#pragma writes vec4 even           // [image_size] the light that is filtered, with grey in it
#pragma writes FOUR result         // [3, size]

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int o = at(pixel, size), area = size.x * size.y;
    if (!inside(pixel, image_size)) {
        for (int k = 0; k < 3; ++k) result[o + k * area] = packed_four(vec4(0.0));
        return;
    }
    int i = at(pixel, image_size), plane = image_size.x * image_size.y;
    vec4 light = shown[i], albedo = shown[i + plane], facing = shown[i + 2 * plane];
    vec3 colour = min(albedo.rgb, 1.0), normal = clamp(0.5 * facing.xyz + 0.5, 0.0, 1.0), rgb = light.rgb;
    if (EVEN == 1) {
        float most = 0.0, once = 1.0 - clamp(light.w - 1.0, 0.0, 1.0);
        ivec2 extent = cells_of(image_size);
        for (int k = 0; k < 9; ++k) {
            ivec2 cell = pixel / AROUND_CELL + ivec2(k % 3, k / 3) - 1;
            if (inside(cell, extent)) most = max(most, cells[at(cell, extent)].x);
        }
        float share = albedo.w * level[1] * facing.w * once * clamp(most - 1.0, 0.0, 1.0);
        share = 1.0 - (1.0 - MIX_SEEN_ONCE) * share;
        rgb = mix(denoised[i].rgb, rgb, share);
    }
    rgb = greyed(rgb);
    even[i] = vec4(rgb, 1.0);
    result[o] = packed_four(vec4(PIXELS_UNIT * compressed(lifted(PIXELS_LIGHT * statistics[0] * rgb)), colour.r));
    result[o + area] = packed_four(vec4(colour.gb, normal.xy));
    result[o + 2 * area] = packed_four(vec4(normal.z, 0.0, 0.0, 0.0));
}
