#version 430
// Keep a share of the detail that only the finer image has:
//
//     out = composed - (1 - share) · (fine - U[D fine])
#pragma constants CHANNELS
#include "tensor.glsl"

#pragma reads float composed  // [B, CHANNELS, H, W]
#pragma reads float fine      // [B, CHANNELS, H, W]
#pragma reads float share     // [B, 1, H, W] in [0, 1]
#pragma writes float result   // [B, CHANNELS, H, W]

int b, c;  // the plane that is softened
#define TYPE float
float fine_value(ivec2 pixel) {
    return fine[at(b, c, pixel, CHANNELS, size)];
}
#include "pool.glsl"

float coarse_value(ivec2 cell) {
    return pool(cell);
}
#include "enlarge.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    float removed = 1.0 - share[at(b, 0, pixel, 1, size)];
    for (c = 0; c < CHANNELS; ++c) {
        int i = at(b, c, pixel, CHANNELS, size);
        result[i] = composed[i] - removed * (fine[i] - enlarged(pixel));
    }
}
