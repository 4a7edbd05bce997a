#version 430
// The kernels' picture, the written one and the previous one as one picture (ops.mix).
#pragma constants USUAL BEFORE LEAST NEEDS_HISTORY MIX_CELL MIX_FAR MIX_NOISE MIX_TELLS MIX_UNCOVERED
#include "around.glsl"
#include "curve.glsl"
#include "past.glsl"

#pragma reads vec4 written         // [H, W] rgb; 0: the sky, where it shows alone
#pragma reads vec4 past            // [H, W] rgb, flags
#pragma reads vec4 seen            // [3, H, W] · albedo, trust ·
#pragma reads vec4 cells, vec4 told  // of `hybrid/cells` and `hybrid/written`
#pragma reads float statistics     // [2] exposure, ·
#pragma reads vec4 denoised        // [H, W] the kernels' picture
#pragma writes vec4 mixed          // [H, W] the mixture

// Mean of a cell and the eight around it.
vec3 told_around(ivec2 cell, ivec2 extent) {
    vec4 sum = vec4(0.0);
    for (int k = 0; k < 9; ++k) {
        ivec2 c = cell + ivec2(k % 3, k / 3) - 1;
        if (inside(c, extent)) sum += vec4(told[at(c, extent)].xyz, 1.0);
    }
    return sum.xyz / sum.w;
}

// The most frames in a footprint around a pixel, and whether a pixel there has a history.
vec2 most_around(ivec2 pixel) {
    ivec2 extent = cells_of(size);
    vec2 most = vec2(0.0);
    for (int k = 0; k < 9; ++k) {
        ivec2 cell = pixel / AROUND_CELL + ivec2(k % 3, k / 3) - 1;
        if (inside(cell, extent)) most = max(most, cells[at(cell, extent)].xy);
    }
    return most;
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    // Linear between the centres of cells.
    ivec2 extent = (size + MIX_CELL - 1) / MIX_CELL;
    vec2 place = max((vec2(pixel) + 0.5) / float(MIX_CELL) - 0.5, 0.0);
    ivec2 low = ivec2(place), high = min(low + 1, extent - 1);
    vec2 f = place - vec2(low);
    vec3 sums = mix(mix(told_around(low, extent), told_around(ivec2(high.x, low.y), extent), f.x),
                    mix(told_around(ivec2(low.x, high.y), extent), told_around(high, extent), f.x), f.y);

    int i = at(pixel, size), plane = size.x * size.y;
    float noise = sums.z + MIX_NOISE, trust = seen[i + plane].w, held = has_history(past[i]) ? 1.0 : 0.0;
    float told_share = clamp((USUAL * noise + sums.x) / (noise + sums.y), 0.0, 1.0);
    vec2 around = most_around(pixel);
    // How far the noisy frame tells of this pixel: less where it was just uncovered and others around it have a history.
    float telling = held + (1.0 - held) * (1.0 - around.y), scale = statistics[0];
    if (NEEDS_HISTORY == 1) trust *= clamp(around.x - 1.0, 0.0, 1.0);
    float share = mix(clamp(told_share, LEAST, USUAL), told_share, telling);
    share = mix(USUAL, share, cells[at(pixel / AROUND_CELL, cells_of(size))].z);  // as far as its word counts
    vec3 kernels = compressed(scale * max(denoised[i].rgb, 0.0)), light = compressed(scale * written[i].rgb);
    if (telling < MIX_TELLS) kernels = light + clamp(kernels - light, -MIX_UNCOVERED, MIX_UNCOVERED);  // just uncovered
    light = mix(light, kernels, trust * share * written[i].w);
    light += trust * BEFORE * held * clamp(compressed(scale * past[i].rgb) - light, -MIX_FAR, MIX_FAR);
    mixed[i] = vec4(expanded(light) / scale, 1.0);
}
