#version 430
// The running mean of the noisy light. The network predicts `reset`, which restarts the mean where light has changed; it
// is written, for `forget` and `hybrid/see`:
//
//     w = 1 / (1 + length),    w' = w + reset · (1 - w),    mean' = w' · light + (1 - w') · mean,
//     length' = min(1 / w', longest - 1)
#pragma parameters float longest
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
    float gives_way = giving_way(sigmoid(row(RESET)), pixel), weight = 1.0 / (1.0 + running[i].w);
    weight += gives_way * (1.0 - weight);
    vec3 rgb = weight * light[i].rgb + (1.0 - weight) * running[i].rgb;
    mean[i] = vec4(rgb, min(1.0 / weight, longest - 1.0));
    reset[i] = gives_way;
}
