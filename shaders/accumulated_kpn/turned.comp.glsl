#version 430
// The share of history that gives way in each cell, as its surfaces have turned (ops.turned):
//
//     1 - exp(-angle / TURNED_ANGLE),    angle = |Σ d| / n · max(0, 1 - TURNED_NOISE · Σ |d|² / |Σ d|²)
//
// with sums over a cell and the eight around it.
#pragma constants TURNED_ANGLE TURNED_NOISE
#include "image.glsl"

#pragma reads vec4 turns     // [h, w] Σ d, Σ |d|²
#pragma reads float counts   // [h, w] n
#pragma writes float turned  // [h, w]

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(cell, size)) return;
    vec4 sum = vec4(0.0);
    float n = 0.0;
    for (int y = -1; y <= 1; ++y)
        for (int x = -1; x <= 1; ++x) {
            ivec2 c = cell + ivec2(x, y);
            if (!inside(c, size)) continue;
            sum += turns[at(c, size)];
            n += counts[at(c, size)];
        }
    float square = dot(sum.xyz, sum.xyz);
    float sure = max(1.0 - TURNED_NOISE * sum.w / max(square, 1e-30), 0.0);
    turned[at(cell, size)] = 1.0 - exp(-sure * sqrt(square) / max(n, 1.0) / TURNED_ANGLE);
}
