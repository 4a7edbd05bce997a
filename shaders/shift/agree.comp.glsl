#version 430
// The shifts of cells that explain how the picture has changed, and what the next frame takes (shift.picture.find).
#pragma constants CELL SHIFT_LEAST SHIFT_GREATEST SHIFT_LEFT SHIFT_SURE SHIFT_APART
#pragma parameters ivec2 image_size
#include "image.glsl"

#pragma reads vec4 shift         // [H, W] of `solve`
#pragma reads vec4 found_before  // [H, W]
#pragma reads vec4 vectors       // [image_size] motion, motion_next
#pragma writes vec4 found        // [H, W] pixels
#pragma writes vec4 agreed       // [H, W] pixels

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(cell, size)) return;

    int i = at(cell, size);
    vec2 its = shift[i].xy;
    float length_of_it = length(its), left = shift[i].w;
    if (!(left < SHIFT_LEFT && length_of_it > SHIFT_LEAST && length_of_it < SHIFT_GREATEST)) its = vec2(0.0);
    ivec2 middle = cell * CELL + CELL / 2;
    vec2 motion = inside(middle, image_size) ? vectors[at(middle, image_size)].xy : vec2(0.0);
    ivec2 there = ivec2(floor(clamp(vec2(cell) + motion / float(CELL), vec2(0.0), vec2(size - 1)) + 0.5));
    vec2 expected = found_before[at(there, size)].xy;
    bool agrees = length(its - expected) <= SHIFT_APART * length_of_it;
    found[i] = vec4(its, 0.0, 0.0);
    agreed[i] = vec4(agrees ? (its + expected) / 2.0 : left < SHIFT_SURE ? its : vec2(0.0), 0.0, 0.0);
}
