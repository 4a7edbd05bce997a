#version 430
// The running mean and its length, where they were (ops.reproject): bilinear, of taps that are on the screen and show the
// surface that is here; 0 where those weigh less than 0.01 together.
//
// takes    vectors, vectors_before [H, W] · surface, surface_before [H, W] · mean_before [H, W] rgb, length
// returns  running [H, W] rgb, length
#include "image.glsl"
#include "history_motion.glsl"
#include "alike.glsl"

layout(std430, binding = 2) readonly restrict buffer Surface { vec4 surface[]; };
layout(std430, binding = 3) readonly restrict buffer SurfaceBefore { vec4 surface_before[]; };
layout(std430, binding = 4) readonly restrict buffer MeanBefore { vec4 mean_before[]; };
layout(std430, binding = 5) writeonly restrict buffer Running { vec4 running[]; };

const float DEPTH_TOLERANCE = 0.1, NORMAL_TOLERANCE = 0.5, LEAST = 1e-2;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    bool uncovered;
    // Far away is as good as off the screen, and its pixel numbers still fit an integer.
    vec2 target = vec2(pixel) + clamp(history_motion(pixel, uncovered), -1e6, 1e6);
    ivec2 corner = ivec2(floor(target));
    vec2 f = target - vec2(corner);
    vec4 here = surface[at(pixel, size)], mean = vec4(0.0);
    float total = 0.0;
    for (int tap = 0; tap < 4; ++tap) {
        ivec2 step = ivec2(tap & 1, tap >> 1), p = corner + step;
        if (!inside(p, size)) continue;
        int i = at(p, size);
        if (!alike(here, surface_before[i], DEPTH_TOLERANCE, NORMAL_TOLERANCE)) continue;
        float weight = (step.x == 1 ? f.x : 1.0 - f.x) * (step.y == 1 ? f.y : 1.0 - f.y);
        total += weight;
        mean += weight * mean_before[i];
    }
    running[at(pixel, size)] = total >= LEAST ? mean / total : vec4(0.0);
}
