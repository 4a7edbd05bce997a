#version 430
// Blend every fine pixel with a weighted mean of the K×K coarse pixels around its own:
//
//     w[b,k,y,x]   = softmax_k logits[b,k,y,x], over the taps k = dy·K + dx that lie inside the coarse image
//     p[b,c,y,x]   = Σ_{dy,dx ∈ 0..K-1} w[b, dy·K+dx, y, x] · coarse[b, c, ⌊y/2⌋+dy-r, ⌊x/2⌋+dx-r],    r = ⌊K/2⌋
//     out[b,c,y,x] = (1 - share) · fine + share · p
#pragma constants CHANNELS
#include "tensor.glsl"
#include "pyramid.glsl"

#pragma reads float fine     // [B, CHANNELS, H, W]
#include "logits.glsl"
#include "softmax.glsl"
#pragma reads float coarse   // [B, CHANNELS, ⌈H/2⌉, ⌈W/2⌉]
#pragma reads float share    // [B, 1, H, W] in [0, 1]
#pragma writes float result  // [B, CHANNELS, H, W]

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), corner = pixel / 2 - KERNEL / 2;
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    first_logit = at(b, 0, pixel, TAPS, size);
    float total = softmax(corner, coarse_size()), s = share[at(b, 0, pixel, 1, size)];
    for (int c = 0; c < CHANNELS; ++c) {
        float sum = 0.0;
        for (int k = 0; k < TAPS; ++k) {
            ivec2 read = clamp(corner + tap(k), ivec2(0), coarse_size() - 1);
            sum += weight[k] * coarse[at(b, c, read, CHANNELS, coarse_size())];
        }
        int i = at(b, c, pixel, CHANNELS, size);
        result[i] = (1.0 - s) * fine[i] + s * sum / total;
    }
}
