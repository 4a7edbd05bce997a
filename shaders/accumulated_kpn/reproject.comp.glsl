#version 430
// Reproject the running means of light and albedo, and their length (ops.reproject): bilinear, from taps that are on the screen
// and show the same surface; 0 where these weigh too little. With RECALLS the mean of light is there already.
//
// The mean of albedo includes this frame at once. The mean of light does not: the network first predicts its `reset`.
//
//     mean_albedo = w · albedo + (1 - w) · mean_albedo_before,    w = 1 / (1 + length)
#pragma constants RECALLS DEPTH_TOLERANCE MIN_NORMAL_COSINE
#include "image.glsl"

#pragma reads vec4 chosen                        // [H, W] motion
#pragma reads vec4 surface, vec4 surface_before  // [H, W] normal, depth
#pragma reads vec4 mean_before                   // [H, W] rgb, length
#pragma reads vec4 mean_albedo_before            // [H, W] rgb
#pragma reads vec4 guide                         // [H, W] rgb
#pragma changes vec4 running                     // [H, W] rgb, length: light, without this frame
#pragma writes vec4 mean_albedo                  // [H, W] rgb, with this frame; whether the surface was there

vec4 surface_before_at(ivec2 p) {
    return surface_before[at(p, size)];
}
#include "reproject.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size);
    vec4 mean = vec4(0.0);
    vec3 albedo = vec3(0.0);
    Taps taps = weigh_taps(pixel, chosen[i].xy, surface[i], DEPTH_TOLERANCE, MIN_NORMAL_COSINE);
    if (is_valid(taps)) {
        for (int t = 0; t < 4; ++t) {
            if (taps.weight[t] == 0.0) continue;
            int before = at(tap_pixel(taps, t), size);
            if (RECALLS == 0) mean += taps.weight[t] * mean_before[before];
            albedo += taps.weight[t] * mean_albedo_before[before].rgb;
        }
        mean /= taps.total;
        albedo /= taps.total;
    }
    if (RECALLS == 1) mean = is_valid(taps) ? running[i] : vec4(0.0);  // light can reach farther back than albedo
    else running[i] = mean;
    float weight = 1.0 / (1.0 + mean.w);
    mean_albedo[i] = vec4(weight * guide[i].rgb + (1.0 - weight) * albedo, is_valid(taps) ? 1.0 : 0.0);
}
