#version 430
// Whether history still belongs to this shot (history.mismatch): of the pixels whose surface was on the screen, those where the
// nearest pixel of the previous frame shows another one.
//
// takes    vectors, surface, surface_before [H, W]
// returns  counts [2], 0 before: pixels on the screen, mismatched ones among them
#include "image.glsl"
#include "on_screen.glsl"
#include "alike.glsl"

layout(std430, binding = 0) readonly restrict buffer Vectors { vec4 vectors[]; };
layout(std430, binding = 1) readonly restrict buffer Surface { vec4 surface[]; };
layout(std430, binding = 2) readonly restrict buffer SurfaceBefore { vec4 surface_before[]; };
layout(std430, binding = 3) restrict buffer Counts { uint counts[]; };

const float DEPTH_TOLERANCE = 0.1, NORMAL_TOLERANCE = 0.5;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size);
    vec2 target = vec2(pixel) + vectors[i].xy;
    if (!on_screen(target)) return;
    atomicAdd(counts[0], 1u);
    if (!alike(surface[i], surface_before[at(nearest(target), size)], DEPTH_TOLERANCE, NORMAL_TOLERANCE)) {
        atomicAdd(counts[1], 1u);
    }
}
