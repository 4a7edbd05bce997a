#version 430
// Sums over cells of CELL² pixels (shift.displacement.displacement_sums): every SHIFT_STRIDE-th pixel along either axis, looked up
// where motion and `shift` lead. One work group per cell; the FIRST round has no shift yet.
#pragma constants CELL FIRST SHIFT_STRIDE DEPTH_TOLERANCE SHIFT_BLOCK CUBIC
#include "image.glsl"
#include "on_screen.glsl"

#pragma reads vec4 pair     // [H, W] of `compress`
#pragma reads vec4 known    // [H, W] of `slopes`
#pragma reads vec4 vectors  // [H, W] motion, motion_next
#pragma reads vec4 surface  // [H, W] normal, depth
#pragma reads float near    // [⌈H/SHIFT_BLOCK⌉, ⌈W/SHIFT_BLOCK⌉] how much the pixels of a block count
#pragma reads vec4 shift    // [⌈H/CELL⌉, ⌈W/CELL⌉] pixels
#pragma writes vec4 sums    // [2, ⌈H/CELL⌉, ⌈W/CELL⌉] w, g_x², g_x g_y, g_y² · g_x e, g_y e, e², 0

#include "cells.glsl"

SPREAD(spread, shift, CELL)

#define TYPE vec4
vec4 value(ivec2 pixel) {
    return known[at(pixel, size)];
}
#include "look_up.glsl"

shared vec4 first[GROUP_X * GROUP_Y], second[GROUP_X * GROUP_Y];

void main() {
    int lane = int(gl_LocalInvocationIndex);
    ivec2 cell = ivec2(gl_WorkGroupID.xy), pixel = cell * CELL + SHIFT_STRIDE * ivec2(gl_LocalInvocationID.xy);
    first[lane] = second[lane] = vec4(0.0);
    if (inside(pixel, size)) {
        int i = at(pixel, size);
        vec2 target = vec2(pixel) + vectors[i].xy;
        if (FIRST == 0) target += spread(pixel, size).xy;
        float weight = near[at(pixel / SHIFT_BLOCK, (size + SHIFT_BLOCK - 1) / SHIFT_BLOCK)], depth = surface[i].w;
        vec4 there = look_up(clamp(target, vec2(0.0), vec2(size - 1)));
        if (on_screen(target) && abs(depth - there.w) <= DEPTH_TOLERANCE * max(depth, there.w)) {
            float x = there.y, y = there.z, apart = pair[i].x - there.x;
            first[lane] = weight * vec4(1.0, x * x, x * y, y * y);
            second[lane] = weight * vec4(x * apart, y * apart, apart * apart, 0.0);
        }
    }
    for (int step = GROUP_X * GROUP_Y / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) {
            first[lane] += first[lane + step];
            second[lane] += second[lane + step];
        }
    }
    if (lane == 0) {
        ivec2 cells = (size + CELL - 1) / CELL;
        sums[at(cell, cells)] = first[0];
        sums[at(cell, cells) + cells.x * cells.y] = second[0];
    }
}
