#version 430
// The shift of light without noise (shift.light.light_shift), around even light with an edge; elsewhere what `told` wrote stays.
#pragma constants CELL SHIFT_BLOCK SHIFT_LEAST SHIFT_GREATEST SHIFT_BESIDE DEPTH_TOLERANCE
#include "image.glsl"

#pragma reads vec4 shift    // [⌈H/CELL⌉, ⌈W/CELL⌉] of `solve`
#pragma reads float near    // [⌈H/SHIFT_BLOCK⌉, ⌈W/SHIFT_BLOCK⌉] of `near`
#pragma reads vec4 blocks   // likewise, of `blocks`
#pragma reads uint edges    // [1] of `near`
#pragma reads vec4 surface  // [H, W] normal, depth
#pragma changes vec4 moved  // [H, W] pixels

#include "cells.glsl"

SPREAD(spread, shift, CELL)

// Whether a pixel lies on a surface of the blocks that count around it.
bool beside(ivec2 pixel, float depth) {
    ivec2 extent = (size + SHIFT_BLOCK - 1) / SHIFT_BLOCK;
    float far = -3e38, nearest = 3e38;
    for (int y = -SHIFT_BESIDE; y <= SHIFT_BESIDE; ++y)
        for (int x = -SHIFT_BESIDE; x <= SHIFT_BESIDE; ++x) {
            ivec2 b = pixel / SHIFT_BLOCK + ivec2(x, y);
            if (!inside(b, extent) || near[at(b, extent)] == 0.0) continue;
            far = max(far, blocks[at(b, extent)].z);
            nearest = min(nearest, blocks[at(b, extent)].w);
        }
    return depth <= (1.0 + DEPTH_TOLERANCE) * far && depth >= (1.0 - DEPTH_TOLERANCE) * nearest;
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size) || edges[0] == 0u) return;

    vec2 found = spread(pixel, size).xy;
    float squared = dot(found, found);
    if (squared <= SHIFT_LEAST * SHIFT_LEAST || squared >= SHIFT_GREATEST * SHIFT_GREATEST) return;
    int i = at(pixel, size);
    if (beside(pixel, surface[i].w)) moved[i] = vec4(found, 0.0, 0.0);
}
