#version 430
// The shift that the frame before told, where each pixel's surface was (shift.picture.moved).
#pragma constants SHIFT_BLOCK
#include "image.glsl"
#include "on_screen.glsl"

#pragma reads vec4 told     // [⌈H/CELL⌉, ⌈W/CELL⌉] pixels
#pragma reads vec4 vectors  // [H, W] motion, motion_next
#pragma reads float flat_blocks  // [⌈H/SHIFT_BLOCK⌉, ⌈W/SHIFT_BLOCK⌉] 1 where depth is that of one surface
#pragma writes vec4 moved   // [H, W] pixels

ivec2 cells;

vec2 cell_value(ivec2 cell) {
    return told[at(cell, cells)].xy;
}
#include "cells.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    cells = (size + CELL - 1) / CELL;
    vec2 shift = vec2(0.0), target = vec2(pixel) + vectors[at(pixel, size)].xy;
    bool one_surface = flat_blocks[at(pixel / SHIFT_BLOCK, (size + SHIFT_BLOCK - 1) / SHIFT_BLOCK)] > 0.0;
    if (one_surface && on_screen(target)) {
        ivec2 there = nearest(target);
        if (cell_value(there / CELL) != vec2(0.0)) shift = spread(there, cells);
    }
    moved[at(pixel, size)] = vec4(shift, 0.0, 0.0);
}
