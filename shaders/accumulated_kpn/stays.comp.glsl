#version 430
// How far the light of a kept frame has stayed as it is, in each cell (ops.recall, u_j):
//
//     clamp((RECALL_CHANGED - q) / (RECALL_CHANGED - RECALL_ALIKE), 0, 1) · the same of wide cells,    q = |Σ d|² / Σ |d|²
//     · with PAIRS clamp((RECALL_JOINED - r) / (RECALL_JOINED - RECALL_WHITE), 0, 1),    r = Σ (d d_x + d d_y) / Σ |d|²
//
// with sums over a cell and the eight around it. A wide cell is 2×2 of them. For a running mean (ops.agrees) bounds are `patience`
// times as high.
#pragma constants PAIRS RECALL_ALIKE RECALL_CHANGED RECALL_WIDE_ALIKE RECALL_WIDE_CHANGED RECALL_WHITE RECALL_JOINED
#pragma parameters float patience
#include "image.glsl"

#pragma reads vec4 cells    // [h, w] Σ d, Σ |d|²
#pragma reads float pairs   // [h, w] of `look`, with PAIRS
#pragma writes float stays  // [h, w]

// The factor of side × side cells, of which `cell` is one, and as many on each side of them.
float unchanged(ivec2 cell, int side, float alike, float changed) {
    ivec2 first = cell / side * side - side;
    vec4 sum = vec4(0.0);
    for (int y = 0; y < 3 * side; ++y)
        for (int x = 0; x < 3 * side; ++x) {
            ivec2 c = first + ivec2(x, y);
            if (inside(c, size)) sum += cells[at(c, size)];
        }
    float q = dot(sum.rgb, sum.rgb) / max(patience * sum.w, 1e-30);
    return clamp((changed - q) / (changed - alike), 0.0, 1.0);
}

// The factor of differences that are white.
float white(ivec2 cell) {
    float products = 0.0, square = 0.0;
    for (int k = 0; k < 9; ++k) {
        ivec2 c = cell + ivec2(k % 3, k / 3) - 1;
        if (!inside(c, size)) continue;
        products += pairs[at(c, size)];
        square += cells[at(c, size)].w;
    }
    float r = products / max(square, 1e-30);
    return clamp((RECALL_JOINED - r) / (RECALL_JOINED - RECALL_WHITE), 0.0, 1.0);
}

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(cell, size)) return;
    float share = unchanged(cell, 1, RECALL_ALIKE, RECALL_CHANGED) * unchanged(cell, 2, RECALL_WIDE_ALIKE, RECALL_WIDE_CHANGED);
    stays[at(cell, size)] = PAIRS == 1 ? share * white(cell) : share;
}
