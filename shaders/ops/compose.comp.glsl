#version 430
// Replace the low frequencies of `fine` by those of `coarse`, as far as α says (eq. 4):
//
//     out = fine - U[α · D fine] + U[α · coarse] = fine + U[α · (coarse - D fine)]
//
// takes    fine [B, CHANNELS, H, W] · coarse [B, CHANNELS, ⌈H/2⌉, ⌈W/2⌉] · alpha [B, 1, ⌈H/2⌉, ⌈W/2⌉] in [0, 1]
// returns  result [B, CHANNELS, H, W]
#pragma constants CHANNELS
#include "tensor.glsl"
#include "pyramid.glsl"

layout(std430, binding = 0) readonly restrict buffer Fine { float fine[]; };
layout(std430, binding = 1) readonly restrict buffer Coarse { float coarse[]; };
layout(std430, binding = 2) readonly restrict buffer Alpha { float alpha[]; };
layout(std430, binding = 3) writeonly restrict buffer Result { float result[]; };
#include "pool.glsl"

float difference(int b, int c, int x, int y) {
    ivec2 cell = ivec2(x, y);
    return alpha[at(b, 0, cell, 1, coarse_size())] * (coarse[at(b, c, cell, CHANNELS, coarse_size())] - pool(b, c, cell));
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    Cells q = cells_of(pixel);
    for (int c = 0; c < CHANNELS; ++c) {
        float near = 0.75 * difference(b, c, q.near.x, q.near.y) + 0.25 * difference(b, c, q.far.x, q.near.y);
        float far = 0.75 * difference(b, c, q.near.x, q.far.y) + 0.25 * difference(b, c, q.far.x, q.far.y);
        result[at(b, c, pixel, CHANNELS, size)] = fine[at(b, c, pixel, CHANNELS, size)] + 0.75 * near + 0.25 * far;
    }
}
