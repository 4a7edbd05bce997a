#version 430
// Compare light with its running mean (ops.agrees): sums over cells of RECALL_CELL² pixels, for `stays`. A work group is a row of
// whole cells.
#pragma constants RECALL_CELL RECALL_ROUNDING
#include "image.glsl"

#pragma reads vec4 light        // [H, W] rgb
#pragma reads vec4 running      // [H, W] rgb: the mean without this frame
#pragma reads vec4 mean_albedo  // [H, W] rgb, whether the surface was there
#pragma writes vec4 cells       // [⌈H/RECALL_CELL⌉, ⌈W/RECALL_CELL⌉] Σ d, Σ |d|² and what is added

shared vec4 terms[GROUP_X * GROUP_Y];

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), lane = ivec2(gl_LocalInvocationID.xy);
    vec4 term = vec4(0.0);
    if (inside(pixel, size)) {
        int i = at(pixel, size);
        vec3 d = mean_albedo[i].w * (running[i].rgb - light[i].rgb);
        term = vec4(d, dot(d, d) + mean_albedo[i].w * RECALL_ROUNDING * dot(light[i].rgb, light[i].rgb));
    }
    terms[lane.y * GROUP_X + lane.x] = term;
    barrier();
    if (lane.x % RECALL_CELL != 0 || lane.y % RECALL_CELL != 0 || !inside(pixel, size)) return;
    vec4 sum = vec4(0.0);
    for (int y = 0; y < RECALL_CELL; ++y)
        for (int x = 0; x < RECALL_CELL; ++x) sum += terms[(lane.y + y) * GROUP_X + lane.x + x];
    cells[at(pixel / RECALL_CELL, (size + RECALL_CELL - 1) / RECALL_CELL)] = sum;
}
