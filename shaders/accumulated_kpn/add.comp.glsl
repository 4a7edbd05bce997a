#version 430
// Add what `look` found to the mean of recent light, as far as the light there has not changed (ops.recall). The FIRST dispatch
// starts from nothing, the LAST divides by the weights.
#pragma constants FIRST LAST RECALL_CELL
#include "image.glsl"

#pragma reads vec4 found      // [H, W] rgb; 0 on another surface, else the share that resets left
#pragma reads float stays     // [⌈H/RECALL_CELL⌉, ⌈W/RECALL_CELL⌉] the share that has not changed
#pragma changes vec4 running  // [H, W] Σ weight · rgb, or at last the mean; Σ weight

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size);
    float weight = found[i].w * stays[at(pixel / RECALL_CELL, (size + RECALL_CELL - 1) / RECALL_CELL)];
    vec4 total = vec4(weight * found[i].rgb, weight);
    if (FIRST == 0) total += running[i];
    if (LAST == 1) total.rgb /= max(total.w, 1e-6);
    running[i] = total;
}
