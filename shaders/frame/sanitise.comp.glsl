#version 430
// The buffers of a frame as they come, made fit for filtering (sanitise.sanitise), four values a pixel. One work group per block of
// 8×8 pixels.
//
// takes    radiance, albedo, normal [3, H, W] · depth [1, H, W]
// returns  clean [H, W]: radiance, 1
//          surface [H, W]: normal, depth
//          guide [H, W]: albedo, and whether light is divided by it: where something was hit, if DEMODULATE
//          maxima [⌈H/8⌉, ⌈W/8⌉]: the greatest luminance of each block
#pragma constants DEMODULATE
#include "image.glsl"
#include "finite.glsl"
#include "luminance.glsl"

layout(std430, binding = 0) readonly restrict buffer Radiance { float radiance[]; };
layout(std430, binding = 1) readonly restrict buffer Albedo { float albedo[]; };
layout(std430, binding = 2) readonly restrict buffer Normal { float normal[]; };
layout(std430, binding = 3) readonly restrict buffer Depth { float depth[]; };
layout(std430, binding = 4) writeonly restrict buffer Clean { vec4 clean[]; };
layout(std430, binding = 5) writeonly restrict buffer Surface { vec4 surface[]; };
layout(std430, binding = 6) writeonly restrict buffer Guide { vec4 guide[]; };
layout(std430, binding = 7) writeonly restrict buffer Maxima { float maxima[]; };

const float BRIGHTEST = 1e15, FAR = 1e9;  // what follows stays finite in float32; from there on nothing was hit
const float GREATEST_ALBEDO = 16.0, LONGEST_NORMAL = 2.0;

shared float partial[GROUP_X * GROUP_Y];

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int lane = int(gl_LocalInvocationIndex);
    partial[lane] = 0.0;
    if (inside(pixel, size)) {
        int i = at(pixel, size), plane = size.x * size.y;
        vec3 rgb, color, facing;
        for (int c = 0; c < 3; ++c) {
            rgb[c] = clamp(finite_or(radiance[c * plane + i], 0.0), 0.0, BRIGHTEST);
            color[c] = clamp(finite_or(albedo[c * plane + i], 0.0), 0.0, GREATEST_ALBEDO);
            facing[c] = clamp(finite_or(normal[c * plane + i], 0.0), -LONGEST_NORMAL, LONGEST_NORMAL);
        }
        float distance = finite_or(depth[i], 0.0);
        if (!(distance > 0.0 && distance < FAR)) distance = 0.0;
        clean[i] = vec4(rgb, 1.0);
        surface[i] = vec4(facing, distance);
        guide[i] = vec4(color, DEMODULATE == 1 && distance > 0.0 ? 1.0 : 0.0);
        partial[lane] = luminance(rgb);
    }
    for (int step = GROUP_X * GROUP_Y / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) partial[lane] = max(partial[lane], partial[lane + step]);
    }
    if (lane == 0) maxima[gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x] = partial[0];
}
