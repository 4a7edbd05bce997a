#version 430
// Compare light with its running mean (ops.agrees): sums over cells of RECALL_CELL² pixels, for `stays`.
#pragma constants RECALL_CELL RECALL_ROUNDING
#include "image.glsl"
#include "sum_cell.glsl"

#pragma reads vec4 light        // [H, W] rgb
#pragma reads vec4 running      // [H, W] rgb: the mean without this frame
#pragma reads vec4 mean_albedo  // [H, W] rgb, whether the surface was there
#pragma writes vec4 cells       // [⌈H/RECALL_CELL⌉, ⌈W/RECALL_CELL⌉] Σ d, Σ |d|² and what is added

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    vec4 term = vec4(0.0);
    if (inside(pixel, size)) {
        int i = at(pixel, size);
        vec3 d = mean_albedo[i].w * (running[i].rgb - light[i].rgb);
        term = vec4(d, dot(d, d) + mean_albedo[i].w * RECALL_ROUNDING * dot(light[i].rgb, light[i].rgb));
    }
    vec4 sum;
    if (sum_cell(pixel, RECALL_CELL, term, sum)) cells[at(pixel / RECALL_CELL, (size + RECALL_CELL - 1) / RECALL_CELL)] = sum;
}
