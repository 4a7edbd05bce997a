#version 430
// The share of history that gives way in each cell, as its surfaces have turned (ops.turned), or their texture has moved
// (ops.retextured):
//
//     turn = 1 - exp(-angle / TURNED_ANGLE),    angle = |Σ d| / n · max(0, 1 - TURNED_NOISE · Σ |d|² / |Σ d|²)
//     texture = clamp((mean beyond - RETEXTURED_LEAST) / (RETEXTURED_MOST - RETEXTURED_LEAST), 0, 1)
//     or, where it is greater, the same of the lesser mean of aparts, MOVED_LEAST and MOVED_MOST
//     share = 1 - (1 - turn) (1 - texture)
//
// with sums over a cell and the eight around it.
#pragma constants RETEXTURED_LEAST RETEXTURED_MOST MOVED_LEAST MOVED_MOST TURNED_ANGLE TURNED_NOISE
#include "image.glsl"

#pragma reads vec4 turns     // [h, w] Σ d, Σ |d|²
#pragma reads vec4 counts    // [h, w] n, how far albedo lies beyond, in so many pixels
#pragma reads vec4 aparts    // [h, w] how much farther away than neighbours to the right, and below
#pragma writes float turned  // [h, w]

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(cell, size)) return;
    vec4 sum = vec4(0.0), count = vec4(0.0);
    vec2 farther = vec2(0.0);
    for (int y = -1; y <= 1; ++y)
        for (int x = -1; x <= 1; ++x) {
            ivec2 c = cell + ivec2(x, y);
            if (!inside(c, size)) continue;
            sum += turns[at(c, size)];
            count += counts[at(c, size)];
            farther += aparts[at(c, size)].xy;
        }
    float square = dot(sum.xyz, sum.xyz);
    float sure = max(1.0 - TURNED_NOISE * sum.w / max(square, 1e-30), 0.0);
    float stays = exp(-sure * sqrt(square) / max(count.x, 1.0) / TURNED_ANGLE);
    float beyond = count.y / max(count.z, 1.0), apart = min(farther.x, farther.y) / max(count.z, 1.0);
    float slid = (beyond - RETEXTURED_LEAST) / (RETEXTURED_MOST - RETEXTURED_LEAST);
    float moved = clamp(max(slid, (apart - MOVED_LEAST) / (MOVED_MOST - MOVED_LEAST)), 0.0, 1.0);
    turned[at(cell, size)] = 1.0 - stays * (1.0 - moved);
}
