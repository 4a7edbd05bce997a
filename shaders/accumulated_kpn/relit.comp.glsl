#version 430
// The mean of light, with SEEN the footprints too, as bright as this frame, or with PICTURE the previous picture as bright as they
// are (ops.relit).
#pragma constants PICTURE SEEN RELIT_CELL
#include "image.glsl"
#include "cells.glsl"

#pragma reads vec4 first, vec4 second    // of `brighter`: g of squares of 4 × 4 cells, and of 2 × 2
#pragma changes vec4 running, vec4 past  // [H, W] rgb, and what stays
#pragma changes vec4 seen                // [3, H, W] rgb, and what stays · two more

SPREAD(g_first, first, 4)
SPREAD(g_second, second, 2)

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;
    int i = at(pixel, size);
    ivec2 cell = pixel / RELIT_CELL, extent = (size + RELIT_CELL - 1) / RELIT_CELL;
    vec3 times = exp(g_first(cell, extent) + g_second(cell, extent));
    if (PICTURE == 1) past[i].rgb *= times;
    else running[i].rgb *= times;
    if (PICTURE == 0 && SEEN == 1) seen[i].rgb *= times;
}
