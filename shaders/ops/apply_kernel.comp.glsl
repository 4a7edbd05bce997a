#version 430
// Filter every pixel with its own softmax-normalised K×K kernel; softmax and application are one pass.
//
//     w[b,k,y,x]   = softmax_k logits[b,k,y,x], over the taps k = dy·K + dx that lie inside the image
//     out[b,c,y,x] = Σ_{dy,dx ∈ 0..K-1} w[b, dy·K+dx, y, x] · image[b, c, y+dy-r, x+dx-r],    r = ⌊K/2⌋
#pragma constants CHANNELS
#include "tensor.glsl"

#pragma reads float image    // [B, CHANNELS, H, W]
#include "logits.glsl"
#include "softmax.glsl"
#pragma writes float result  // [B, CHANNELS, H, W]

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), corner = pixel - KERNEL / 2;
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    first_logit = at(b, 0, pixel, TAPS, size);
    float total = softmax(corner, size);
    float sum[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c) sum[c] = 0.0;
    for (int k = 0; k < TAPS; ++k) {
        // A tap outside weighs nothing; reading the border pixel in its place is cheaper than branching round the read.
        ivec2 read = clamp(corner + tap(k), ivec2(0), size - 1);
        for (int c = 0; c < CHANNELS; ++c) sum[c] += weight[k] * image[at(b, c, read, CHANNELS, size)];
    }
    for (int c = 0; c < CHANNELS; ++c) result[at(b, c, pixel, CHANNELS, size)] = sum[c] / total;
}
