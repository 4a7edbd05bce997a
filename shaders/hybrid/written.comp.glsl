#version 430
// The light that the network wrote, between the least and the greatest around each pixel (ops.around.expand_within); and what
// the noisy frame tells of it and of the kernels' picture (ops.mix.share_told): means over cells of MIX_CELL² pixels.
#pragma constants USUAL PIXELS_LIGHT PIXELS_UNIT MIX_CELL MIX_DARK MIX_LARGEST
#pragma parameters ivec2 padded
#include "around.glsl"
#include "activations.glsl"
#include "albedo.glsl"
#include "lift.glsl"
#include "sum_cell.glsl"

#pragma reads FOUR compressed_light    // [1, padded] what the network wrote
#pragma reads vec4 bounds              // of `hybrid/bounds`
#pragma reads vec4 denoised            // [H, W] the kernels' picture
#pragma reads vec4 light, vec4 guide   // [H, W]
#pragma reads float statistics         // [2] exposure, ·
#pragma writes vec4 written            // [H, W] rgb; whether it, or a pixel around, hit something
#pragma writes vec4 told               // [⌈H/MIX_CELL⌉, ⌈W/MIX_CELL⌉] (p - q)(y - q), (p - q)², (y - m)², 0

vec3 within(ivec2 pixel, vec3 rgb) {
    ivec2 extent = cells_of(size);
    vec3 low = vec3(3e38), high = vec3(0.0);
    for (int k = 0; k < 9; ++k) {
        ivec2 cell = pixel / AROUND_CELL + ivec2(k % 3, k / 3) - 1;
        if (!inside(cell, extent)) continue;
        low = min(low, bounds[at(cell, extent)].rgb);
        high = max(high, bounds[at(cell, extent) + extent.x * extent.y].rgb);
    }
    return clamp(rgb, low, high);
}

bool hits_around(ivec2 pixel) {
    for (int k = 0; k < 9; ++k) {
        ivec2 p = pixel + ivec2(k % 3, k / 3) - 1;
        if (inside(p, size) && guide[at(p, size)].w != 0.0) return true;
    }
    return false;
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    vec4 term = vec4(0.0);  // the last one counts pixels
    if (inside(pixel, size)) {
        int i = at(pixel, size);
        vec3 wrote = unpacked(compressed_light[in_group(0, pixel, padded)]).rgb;
        vec3 p = denoised[i].rgb, lit = lowered(expanded(wrote / PIXELS_UNIT)) / (PIXELS_LIGHT * statistics[0]);
        vec3 q = coloured(within(pixel, lit));
        vec3 y = light[i].rgb * divisor(guide[i]), m = mix(q, p, USUAL);
        float relative = statistics[0] / (statistics[0] * (m.r + m.g + m.b) / 3.0 + MIX_DARK);
        vec3 apart = relative * (p - q), left = min(relative * (y - q), MIX_LARGEST);
        vec3 noise = min(relative * (y - m), MIX_LARGEST);
        term = vec4(dot(apart, left), dot(apart, apart), dot(noise, noise), 1.0);
        written[i] = vec4(q, hits_around(pixel) ? 1.0 : 0.0);
    }
    vec4 sum;
    if (!sum_cell(pixel, MIX_CELL, term, sum)) return;
    told[at(pixel / MIX_CELL, (size + MIX_CELL - 1) / MIX_CELL)] = vec4(sum.xyz / sum.w, 0.0);
}
