#version 430
// The most frames in a footprint of each cell, and whether one of its pixels has a history; one work group per cell.
#include "around.glsl"
#include "past.glsl"

#pragma reads vec4 seen    // [3, H, W] rgb, frames · …
#pragma reads vec4 past    // [H, W] rgb, flags
#pragma reads float level  // [3] ·, ·, how much the noisy frame's word counts
#pragma writes vec4 cells  // [⌈H/AROUND_CELL⌉, ⌈W/AROUND_CELL⌉] frames, history, that word (for `mix`), 0

shared vec2 partial[GROUP_X * GROUP_Y];

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int lane = int(gl_LocalInvocationIndex), i = at(pixel, size);
    partial[lane] = vec2(0.0);
    if (inside(pixel, size)) partial[lane] = vec2(seen[i].w, has_history(past[i]) ? 1.0 : 0.0);
    for (int step = GROUP_X * GROUP_Y / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) partial[lane] = max(partial[lane], partial[lane + step]);
    }
    if (lane == 0) cells[at(ivec2(gl_WorkGroupID.xy), cells_of(size))] = vec4(partial[0], level[2], 0.0);
}
