#version 430
// Running means of light and albedo, and their length, where they were (ops.reproject): bilinear, of taps that are on the
// screen and show the surface that is here; 0 where those weigh less than 0.01 together, and in a first frame (HISTORY 0).
// This frame's albedo is added to its mean at once, light only when the network has said how far the mean is to be given up:
//
//     mean_albedo' = w · albedo + (1 - w) · mean_albedo,    w = 1 / (1 + length)
//
// takes    chosen [H, W] motion · surface, surface_before [H, W] · mean_before [H, W] rgb, length · mean_albedo_before, guide
//          [H, W] rgb
// returns  running [H, W] rgb, length: light, without this frame · mean_albedo [H, W] rgb, with this frame
#pragma constants HISTORY
#include "image.glsl"
#include "alike.glsl"

layout(std430, binding = 0) readonly restrict buffer Chosen { vec4 chosen[]; };
layout(std430, binding = 1) readonly restrict buffer Surface { vec4 surface[]; };
layout(std430, binding = 2) readonly restrict buffer SurfaceBefore { vec4 surface_before[]; };
layout(std430, binding = 3) readonly restrict buffer MeanBefore { vec4 mean_before[]; };
layout(std430, binding = 4) readonly restrict buffer MeanAlbedoBefore { vec4 mean_albedo_before[]; };
layout(std430, binding = 5) readonly restrict buffer Guide { vec4 guide[]; };
layout(std430, binding = 6) writeonly restrict buffer Running { vec4 running[]; };
layout(std430, binding = 7) writeonly restrict buffer MeanAlbedo { vec4 mean_albedo[]; };

const float DEPTH_TOLERANCE = 0.1, NORMAL_TOLERANCE = 0.5, LEAST = 1e-2;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    vec4 mean = vec4(0.0);
    vec3 albedo = vec3(0.0);
    float total = 0.0;
#if HISTORY
    // Far away is as good as off the screen, and its pixel numbers still fit an integer.
    vec2 target = vec2(pixel) + clamp(chosen[at(pixel, size)].xy, -1e6, 1e6);
    ivec2 corner = ivec2(floor(target));
    vec2 f = target - vec2(corner);
    vec4 here = surface[at(pixel, size)];
    for (int tap = 0; tap < 4; ++tap) {
        ivec2 step = ivec2(tap & 1, tap >> 1), p = corner + step;
        if (!inside(p, size)) continue;
        int i = at(p, size);
        if (!alike(here, surface_before[i], DEPTH_TOLERANCE, NORMAL_TOLERANCE)) continue;
        float weight = (step.x == 1 ? f.x : 1.0 - f.x) * (step.y == 1 ? f.y : 1.0 - f.y);
        total += weight;
        mean += weight * mean_before[i];
        albedo += weight * mean_albedo_before[i].rgb;
    }
#endif
    bool valid = total >= LEAST;
    mean = valid ? mean / total : vec4(0.0);
    albedo = valid ? albedo / total : vec3(0.0);
    float weight = 1.0 / (1.0 + mean.w);
    running[at(pixel, size)] = mean;
    mean_albedo[at(pixel, size)] = vec4(weight * guide[at(pixel, size)].rgb + (1.0 - weight) * albedo, 0.0);
}
