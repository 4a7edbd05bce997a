#version 430
// The buffers of a frame as they come, made fit for filtering (frame.sanitise), four values a pixel; and what they hold
// block by block, for `statistics`. One work group per block of 8×8 pixels.
//
// takes    radiance, albedo, normal [3, H, W] · depth [1, H, W]
// returns  light [H, W]: rgb, divided by the albedo where DEMODULATE says so; 1
//          surface [H, W]: normal, depth
//          guide [H, W]: albedo, and whether light was divided by it
//          blocks [⌈H/8⌉, ⌈W/8⌉]: mean luminance of the light, sum of the depths, number of hits
#pragma constants DEMODULATE
#include "image.glsl"
#include "albedo.glsl"
#include "finite.glsl"

layout(std430, binding = 0) readonly restrict buffer Radiance { float radiance[]; };
layout(std430, binding = 1) readonly restrict buffer Albedo { float albedo[]; };
layout(std430, binding = 2) readonly restrict buffer Normal { float normal[]; };
layout(std430, binding = 3) readonly restrict buffer Depth { float depth[]; };
layout(std430, binding = 4) writeonly restrict buffer Light { vec4 light[]; };
layout(std430, binding = 5) writeonly restrict buffer Surface { vec4 surface[]; };
layout(std430, binding = 6) writeonly restrict buffer Guide { vec4 guide[]; };
layout(std430, binding = 7) writeonly restrict buffer Blocks { vec4 blocks[]; };

const float BRIGHTEST = 1e15, FAR = 1e9;  // what follows stays finite in float32; from there on nothing was hit

shared vec4 partial[GROUP_X * GROUP_Y];

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int lane = int(gl_LocalInvocationIndex);
    partial[lane] = vec4(0.0);
    if (inside(pixel, size)) {
        int i = at(pixel, size), plane = size.x * size.y;
        vec3 rgb, color, facing;
        for (int c = 0; c < 3; ++c) {
            rgb[c] = clamp(finite_or(radiance[c * plane + i], 0.0), 0.0, BRIGHTEST);
            color[c] = finite_or(albedo[c * plane + i], 0.0);
            facing[c] = finite_or(normal[c * plane + i], 0.0);
        }
        float distance = finite_or(depth[i], 0.0);
        if (!(distance > 0.0 && distance < FAR)) distance = 0.0;

        vec4 divided = vec4(color, DEMODULATE == 1 && distance > 0.0 ? 1.0 : 0.0);
        rgb /= divisor(divided);
        light[i] = vec4(rgb, 1.0);
        surface[i] = vec4(facing, distance);
        guide[i] = divided;
        partial[lane] = vec4(dot(rgb, vec3(0.2126, 0.7152, 0.0722)), distance, distance > 0.0 ? 1.0 : 0.0, 1.0);
    }
    for (int step = GROUP_X * GROUP_Y / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) partial[lane] += partial[lane + step];
    }
    if (lane == 0) {
        vec4 sum = partial[0];
        blocks[gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x] = vec4(sum.x / sum.w, sum.yz, 0.0);
    }
}
