#version 430
// How much brighter light is now than its mean, or with PICTURE that mean than the previous picture (ops.relit): sums over cells of
// RELIT_CELL² pixels, for `brighter`. With SEEN footprints tell the mean.
#pragma constants PICTURE SEEN RELIT_CELL
#include "image.glsl"
#include "albedo.glsl"
#include "past.glsl"
#include "sum_cell.glsl"

#pragma reads vec4 light, vec4 running  // [H, W] rgb · rgb, length: the mean without this frame
#pragma reads vec4 past, vec4 guide     // [H, W] rgb, flags · albedo; with PICTURE
#pragma reads vec4 seen                 // [3, H, W] rgb, frames · two more; with PICTURE and SEEN
#pragma writes vec4 cells               // [2, ⌈H/RELIT_CELL⌉, ⌈W/RELIT_CELL⌉] sums of before, of now

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), extent = (size + RELIT_CELL - 1) / RELIT_CELL;
    vec4 before = vec4(0.0), now = vec4(0.0), sum;
    if (inside(pixel, size)) {
        int i = at(pixel, size);
        if (PICTURE == 0) {
            before = running[i];
            now = light[i];
        } else if (has_history(past[i])) {
            before = vec4(past[i].rgb, SEEN == 1 ? seen[i].w : running[i].w);
            now.rgb = SEEN == 1 ? seen[i].rgb : running[i].rgb * divisor(guide[i]);
        }
        if (before.w <= 0.0) before = now = vec4(0.0);
    }
    int cell = at(pixel / RELIT_CELL, extent);
    if (sum_cell(pixel, RELIT_CELL, before, sum)) cells[cell] = sum;
    barrier();
    if (sum_cell(pixel, RELIT_CELL, now, sum)) cells[cell + extent.x * extent.y] = sum;
}
