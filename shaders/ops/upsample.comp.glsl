#version 430
// U of eq. 4: bilinear ×2. Fine pixel x samples the coarse row at u = clamp((x + ½)/2 - ½, 0, ·), borders repeated.
//
// takes    coarse [B, CHANNELS, ⌈H/2⌉, ⌈W/2⌉]
// returns  result [B, CHANNELS, H, W]
#pragma constants CHANNELS
#include "tensor.glsl"
#include "pyramid.glsl"

layout(std430, binding = 0) readonly restrict buffer Coarse { float coarse[]; };
layout(std430, binding = 1) writeonly restrict buffer Result { float result[]; };

float value(int b, int c, int x, int y) {
    return coarse[at(b, c, ivec2(x, y), CHANNELS, coarse_size())];
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    Cells q = cells_of(pixel);
    for (int c = 0; c < CHANNELS; ++c) {
        float near = 0.75 * value(b, c, q.near.x, q.near.y) + 0.25 * value(b, c, q.far.x, q.near.y);
        float far = 0.75 * value(b, c, q.near.x, q.far.y) + 0.25 * value(b, c, q.far.x, q.far.y);
        result[at(b, c, pixel, CHANNELS, size)] = 0.75 * near + 0.25 * far;
    }
}
