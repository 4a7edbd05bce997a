#version 430
// out = α · spatial + (1 - α) · temporal
#pragma constants CHANNELS
#include "tensor.glsl"

#pragma reads float spatial, float temporal  // [B, CHANNELS, H, W]
#pragma reads float alpha                    // [B, 1, H, W] in [0, 1]
#pragma writes float result                  // [B, CHANNELS, H, W]

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
