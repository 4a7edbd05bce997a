#version 430
// The shift that the frame before told, where each pixel's surface was (shift.picture.moved).
#pragma constants CELL SHIFT_BLOCK
#include "image.glsl"
#include "on_screen.glsl"

#pragma reads vec4 told     // [⌈H/CELL⌉, ⌈W/CELL⌉] pixels
#pragma reads vec4 vectors  // [H, W] motion, motion_next
#pragma reads float flat_blocks  // [⌈H/SHIFT_BLOCK⌉, ⌈W/SHIFT_BLOCK⌉] 1 where depth is that of one surface
#pragma writes vec4 moved   // [H, W] pixels

#include "cells.glsl"

SPREAD(spread, told, CELL)

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    vec2 shift = vec2(0.0), target = vec2(pixel) + vectors[at(pixel, size)].xy;
    bool one_surface = flat_blocks[at(pixel / SHIFT_BLOCK, (size + SHIFT_BLOCK - 1) / SHIFT_BLOCK)] > 0.0;
    if (one_surface && on_screen(target)) {
        ivec2 there = nearest(target);
        if (told[at(there / CELL, (size + CELL - 1) / CELL)].xy != vec2(0.0)) shift = spread(there, size).xy;
    }
    moved[at(pixel, size)] = vec4(shift, 0.0, 0.0);
}
