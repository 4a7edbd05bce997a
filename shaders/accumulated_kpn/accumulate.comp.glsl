#version 430
// The running mean of the noisy light. The network says `reset`, which is written for `forget` and `hybrid/see`. It restarts the
// mean where light has changed, with what gives way beside:
//
//     w = 1 / (1 + length),    w' = w + giving_way(reset) · (1 - w),    mean' = w' · light + (1 - w') · mean,
//     length' = min(1 / w', longest - 1)
//
// A mean that differs from light by the share `same` or less counts as light: kept frames are bfloat16.
#pragma parameters float longest, float same
#include "image.glsl"
#include "shares.glsl"
#include "giving_way.glsl"

#pragma reads vec4 light    // [H, W] rgb
#pragma reads vec4 running  // [H, W] rgb, length: the mean without this frame
#pragma writes vec4 mean    // [H, W] rgb, length: the mean with it
#pragma writes float reset  // [H, W]

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    predict(pixel);
    int i = at(pixel, size);
    float said = sigmoid(row(RESET)), weight = 1.0 / (1.0 + running[i].w);
    weight += giving_way(said, pixel) * (1.0 - weight);
    vec3 now = light[i].rgb, before = running[i].rgb;
    before = mix(before, now, lessThanEqual(abs(before - now), same * abs(now)));
    vec3 rgb = weight * now + (1.0 - weight) * before;
    mean[i] = vec4(rgb, min(1.0 / weight, longest - 1.0));
    reset[i] = said;
}
