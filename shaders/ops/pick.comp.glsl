#version 430
// Let every fine pixel pick from the K×K coarse ones around its own, as far as its share says:
//
//     w[b,k,y,x]   = softmax_k logits[b,k,y,x], over the taps k = dy·K + dx that lie inside the coarse image
//     p[b,c,y,x]   = Σ_{dy,dx ∈ 0..K-1} w[b, dy·K+dx, y, x] · coarse[b, c, ⌊y/2⌋+dy-r, ⌊x/2⌋+dx-r],    r = ⌊K/2⌋
//     out[b,c,y,x] = (1 - share) · fine + share · p
//
// takes    fine [B, CHANNELS, H, W] · logits [B, KERNEL², H, W], float or packed half (LOGITS_HALF) ·
//          coarse [B, CHANNELS, ⌈H/2⌉, ⌈W/2⌉] · share [B, 1, H, W] in [0, 1]
// returns  result [B, CHANNELS, H, W]
#pragma constants KERNEL CHANNELS LOGITS_HALF
#include "tensor.glsl"
#include "pyramid.glsl"

layout(std430, binding = 0) readonly restrict buffer Fine { float fine[]; };
#include "logits.glsl"
layout(std430, binding = 2) readonly restrict buffer Coarse { float coarse[]; };
layout(std430, binding = 3) readonly restrict buffer Share { float share[]; };
layout(std430, binding = 4) writeonly restrict buffer Result { float result[]; };

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    // The maximum is taken over the taps inside only: a tap outside must not push the others below what exp can hold.
    int first = at(b, 0, pixel, TAPS, size), plane = size.x * size.y;  // tap k lies at first + k · plane
    ivec2 corner = pixel / 2 - KERNEL / 2;
    float greatest = LOWEST;
    for (int k = 0; k < TAPS; ++k) {
        if (inside(corner + ivec2(k % KERNEL, k / KERNEL), coarse_size())) greatest = max(greatest, logit(first + k * plane));
    }
    float total = 0.0;
    float sum[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c) sum[c] = 0.0;
    for (int k = 0; k < TAPS; ++k) {
        ivec2 tap = corner + ivec2(k % KERNEL, k / KERNEL);
        if (!inside(tap, coarse_size())) continue;
        float w = exp(logit(first + k * plane) - greatest);
        total += w;
        for (int c = 0; c < CHANNELS; ++c) sum[c] += w * coarse[at(b, c, tap, CHANNELS, coarse_size())];
    }
    float s = share[at(b, 0, pixel, 1, size)];
    for (int c = 0; c < CHANNELS; ++c) {
        int i = at(b, c, pixel, CHANNELS, size);
        result[i] = (1.0 - s) * fine[i] + s * sum[c] / total;
    }
}
