#version 430
// Every pixel takes a weighted mean of the values in the window of its block: BLOCK×BLOCK pixels, and HALO more on every
// side. For a head of D = CHANNELS / HEADS channels and the positions n of the window that lie inside the picture:
//
//     e[n]     = (rows[:, n_y], columns[:, n_x])
//     s[h,p,n] = q[h,p] · (k[h,n] + e[n]) / √D
//     out[h,p] = Σ_n softmax_n(s[h,p,n]) · v[h,n]
//
// One pass over the window: sums are rescaled whenever a greater score is found. In groups of 8×8 all invocations of a
// block read the same keys and values at the same time.
#pragma constants CHANNELS HEADS BLOCK HALO
#include "tensor.glsl"

const int D = CHANNELS / HEADS, WINDOW = BLOCK + 2 * HALO;
const float LOWEST = -3.402823466e38;

#pragma reads float q        // [B, CHANNELS, H, W]
#pragma reads float k        // [B, CHANNELS, H, W]
#pragma reads float v        // [B, CHANNELS, H, W]
#pragma reads float rows     // [D / 2, WINDOW]
#pragma reads float columns  // [D / 2, WINDOW]
#pragma writes float result  // [B, CHANNELS, H, W]

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), corner = pixel / BLOCK * BLOCK - HALO;
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    for (int head = 0; head < HEADS; ++head) {
        float query[D], sum[D], greatest = LOWEST, total = 0.0;
        for (int c = 0; c < D; ++c) {
            query[c] = q[at(b, head * D + c, pixel, CHANNELS, size)] * inversesqrt(float(D));
            sum[c] = 0.0;
        }
        for (int n = 0; n < WINDOW * WINDOW; ++n) {
            ivec2 place = ivec2(n % WINDOW, n / WINDOW), read = corner + place;
            if (!inside(read, size)) continue;
            float score = 0.0;
            for (int c = 0; c < D; ++c) {
                float offset = c < D / 2 ? rows[c * WINDOW + place.y] : columns[(c - D / 2) * WINDOW + place.x];
                score += query[c] * (k[at(b, head * D + c, read, CHANNELS, size)] + offset);
            }
            if (score > greatest) {
                float shrink = exp(greatest - score);
                total *= shrink;
                for (int c = 0; c < D; ++c) sum[c] *= shrink;
                greatest = score;
            }
            float weight = exp(score - greatest);
            total += weight;
            for (int c = 0; c < D; ++c) sum[c] += weight * v[at(b, head * D + c, read, CHANNELS, size)];
        }
        for (int c = 0; c < D; ++c) result[at(b, head * D + c, pixel, CHANNELS, size)] = sum[c] / total;
    }
}
