#version 430
// Add what `look` found to the mean of recent light, as far as the light there has not changed (ops.recall):
//
//     weight = found.w · clamp((RECALL_CHANGED - q) / (RECALL_CHANGED - RECALL_ALIKE), 0, 1) · the same of wide cells,
//     q = |Σ d|² / Σ |d|²
//
// with sums over a cell and the eight around it. A wide cell is 2×2 of them. The FIRST dispatch starts from nothing, the LAST divides by the weights.
#pragma constants FIRST LAST RECALL_CELL RECALL_ALIKE RECALL_CHANGED RECALL_WIDE_ALIKE RECALL_WIDE_CHANGED
#include "image.glsl"

#pragma reads vec4 found      // [H, W] rgb; 0 on another surface, else the share that resets left
#pragma reads vec4 cells      // [⌈H/RECALL_CELL⌉, ⌈W/RECALL_CELL⌉] Σ d, Σ |d|²
#pragma changes vec4 running  // [H, W] Σ weight · rgb, or at last the mean; Σ weight

// The weight of light that is unchanged in side × side cells and as many on each side of them.
float unchanged(ivec2 cell, ivec2 extent, int side, float alike, float changed) {
    ivec2 first = cell / side * side - side;
    vec4 sum = vec4(0.0);
    for (int y = 0; y < 3 * side; ++y)
        for (int x = 0; x < 3 * side; ++x) {
            ivec2 c = first + ivec2(x, y);
            if (inside(c, extent)) sum += cells[at(c, extent)];
        }
    float q = dot(sum.rgb, sum.rgb) / max(sum.w, 1e-30);
    return clamp((changed - q) / (changed - alike), 0.0, 1.0);
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    ivec2 extent = (size + RECALL_CELL - 1) / RECALL_CELL, cell = pixel / RECALL_CELL;
    int i = at(pixel, size);
    float weight = found[i].w * unchanged(cell, extent, 1, RECALL_ALIKE, RECALL_CHANGED);
    weight *= unchanged(cell, extent, 2, RECALL_WIDE_ALIKE, RECALL_WIDE_CHANGED);
    vec4 total = vec4(weight * found[i].rgb, weight);
    if (FIRST == 0) total += running[i];
    if (LAST == 1) total.rgb /= max(total.w, 1e-6);
    running[i] = total;
}
