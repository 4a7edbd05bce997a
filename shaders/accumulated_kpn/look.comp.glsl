#version 430
// Look a kept frame up at the end of each pixel's path (ops.recall), and compare its light with this frame's: sums over cells
// of RECALL_CELL² pixels, and of products of pairs of pixels, for `stays`. The path goes on by the motion found there.
#pragma constants FIRST RECALL_CELL RECALL_ROUNDING DEPTH_TOLERANCE MIN_NORMAL_COSINE
#include "image.glsl"
#include "alike.glsl"
#include "kept.glsl"
#include "sum_cell.glsl"

#pragma reads vec4 light, vec4 surface  // [H, W] rgb; normal, depth
#pragma reads vec4 chosen               // [H, W] motion to the frame before, where the paths begin
#pragma changes vec4 path               // [H, W] motion to the kept frame, share that resets left; not read by the FIRST
#pragma writes vec4 found               // [H, W] its rgb, this share, or 0 where it shows another surface
#pragma writes vec4 cells               // [⌈H/RECALL_CELL⌉, ⌈W/RECALL_CELL⌉] Σ d, Σ |d|² and what is added
#pragma writes float pairs              // likewise, Σ of the products of d with that beside and that below

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    vec4 term = vec4(0.0);
    if (inside(pixel, size)) {
        int i = at(pixel, size);
        vec3 come = FIRST == 1 ? vec3(chosen[i].xy, 1.0) : path[i].xyz;
        vec2 motion = bounded(come.xy);
        ivec2 end = end_of(pixel, motion);
        vec4 on = vec4(FAR_AWAY, FAR_AWAY, come.z, 0.0), its = vec4(0.0);
        vec3 d = vec3(0.0), now = max(light[i].rgb, 0.0);
        float least = 0.0;
        if (inside(end, size)) {
            KeptPixel there = kept_at(end);
            float same = alike(surface[i], there.surface, DEPTH_TOLERANCE, MIN_NORMAL_COSINE) ? 1.0 : 0.0;
            on = vec4(motion + there.motion, come.z * (1.0 - there.reset), 0.0);
            its = vec4(there.light, same * come.z);
            d = same * (sqrt(max(there.light, 0.0)) - sqrt(now));
            least = same * RECALL_ROUNDING * (now.r + now.g + now.b);
        }
        path[i] = on;
        found[i] = its;
        term = vec4(d, dot(d, d) + least);
    }
    vec4 sum;
    if (!sum_cell(pixel, RECALL_CELL, term, sum)) return;
    float products = 0.0;
    int first = int(gl_LocalInvocationID.y) * GROUP_X + int(gl_LocalInvocationID.x);
    for (int k = 0; k < RECALL_CELL * RECALL_CELL / 2; ++k) {
        int aside = first + k / (RECALL_CELL / 2) * GROUP_X + k % (RECALL_CELL / 2) * 2;
        int below = first + k / RECALL_CELL * 2 * GROUP_X + k % RECALL_CELL;
        products += dot(terms[aside].rgb, terms[aside + 1].rgb);
        products += dot(terms[below].rgb, terms[below + GROUP_X].rgb);
    }
    int cell = at(pixel / RECALL_CELL, (size + RECALL_CELL - 1) / RECALL_CELL);
    cells[cell] = sum;
    pairs[cell] = products;
}
