#version 430
// Filter every pixel with its own softmax-normalised K×K kernel; softmax and application are one pass.
//
//     w[b,k,y,x]   = softmax_k logits[b,k,y,x], over the taps k = dy·K + dx that lie inside the image
//     out[b,c,y,x] = Σ_{dy,dx ∈ 0..K-1} w[b, dy·K+dx, y, x] · image[b, c, y+dy-r, x+dx-r],    r = ⌊K/2⌋
//
// takes    image [B, CHANNELS, H, W] float · logits [B, KERNEL², H, W], float or packed half (LOGITS_HALF)
// returns  result [B, CHANNELS, H, W] float
#pragma constants KERNEL CHANNELS LOGITS_HALF
#include "tensor.glsl"

layout(std430, binding = 0) readonly restrict buffer Image { float image[]; };
#include "logits.glsl"
layout(std430, binding = 2) writeonly restrict buffer Result { float result[]; };

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    // The maximum is taken over the taps inside only: a tap outside must not push the others below what exp can hold.
    int first = at(b, 0, pixel, TAPS, size), plane = size.x * size.y;  // tap k lies at first + k · plane
    float weight[TAPS];
    float greatest = LOWEST;
    for (int dy = 0; dy < KERNEL; ++dy) {
        for (int dx = 0; dx < KERNEL; ++dx) {
            int k = dy * KERNEL + dx;
            bool counts = inside(pixel + ivec2(dx, dy) - KERNEL / 2, size);
            weight[k] = counts ? logit(first + k * plane) : LOWEST;
            greatest = max(greatest, weight[k]);
        }
    }

    // A tap outside weighs nothing; reading the border pixel in its place is cheaper than branching round the read.
    float total = 0.0;
    float sum[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c) sum[c] = 0.0;
    for (int dy = 0; dy < KERNEL; ++dy) {
        for (int dx = 0; dx < KERNEL; ++dx) {
            ivec2 tap = pixel + ivec2(dx, dy) - KERNEL / 2;
            ivec2 read = clamp(tap, ivec2(0), size - 1);
            float w = inside(tap, size) ? exp(weight[dy * KERNEL + dx] - greatest) : 0.0;
            total += w;
            for (int c = 0; c < CHANNELS; ++c) sum[c] += w * image[at(b, c, read, CHANNELS, size)];
        }
    }
    for (int c = 0; c < CHANNELS; ++c) result[at(b, c, pixel, CHANNELS, size)] = sum[c] / total;
}
