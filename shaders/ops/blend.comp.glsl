#version 430
// out = α · spatial + (1 - α) · temporal
//
// takes    spatial, temporal [B, CHANNELS, H, W] · alpha [B, 1, H, W] in [0, 1]
// returns  result [B, CHANNELS, H, W]
#pragma constants CHANNELS
#include "tensor.glsl"

layout(std430, binding = 0) readonly restrict buffer Spatial { float spatial[]; };
layout(std430, binding = 1) readonly restrict buffer Temporal { float temporal[]; };
layout(std430, binding = 2) readonly restrict buffer Alpha { float alpha[]; };
layout(std430, binding = 3) writeonly restrict buffer Result { float result[]; };

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    float a = alpha[at(b, 0, pixel, 1, size)];
    for (int c = 0; c < CHANNELS; ++c) {
        int i = at(b, c, pixel, CHANNELS, size);
        result[i] = a * spatial[i] + (1.0 - a) * temporal[i];
    }
}
