#version 430
// The mixture without fireflies (ops.fireflies): a pixel that history does not know is no brighter than the second brightest of
// the eight around it, where at least LEAST of these may show its surface; 9: nowhere.
#pragma constants LEAST MIN_NORMAL_COSINE DEPTH_TOLERANCE
#include "image.glsl"
#include "alike.glsl"
#include "past.glsl"

#pragma reads vec4 mixed      // [H, W] rgb
#pragma reads vec4 surface    // [H, W] normal, depth
#pragma reads vec4 past       // [H, W] rgb, flags
#pragma reads vec4 seen       // [3, H, W] · albedo, trust ·
#pragma writes vec4 denoised  // [H, W] rgb: for history
#pragma writes float result   // [3, H, W]: the same

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size), plane = size.x * size.y;
    vec3 rgb = mixed[i].rgb;
    bool inner = all(greaterThan(pixel, ivec2(0))) && all(lessThan(pixel, size - 1));
    if (LEAST <= 8 && inner && surface[i].w > 0.0) {
        int same = 0;
        vec3 greatest = vec3(-3e38), second = vec3(-3e38);
        for (int k = 0; k < 9; ++k) {
            int j = i + (k / 3 - 1) * size.x + k % 3 - 1;
            if (k == 4) continue;
            if (alike(surface[i], surface[j], DEPTH_TOLERANCE, MIN_NORMAL_COSINE)) ++same;
            second = max(second, min(greatest, mixed[j].rgb));
            greatest = max(greatest, mixed[j].rgb);
        }
        float known = has_history(past[i]) ? seen[i + plane].w : 0.0;
        if (same >= LEAST) rgb = mix(min(rgb, second), rgb, known);
    }
    denoised[i] = vec4(rgb, 1.0);
    for (int c = 0; c < 3; ++c) result[c * plane + i] = rgb[c];
}
