#version 430
// The previous output, where it was; where that is off the screen, and in a first frame (HISTORY 0), the noise.
//
// CUBIC: Catmull-Rom, else bilinear. DUAL 0: traditional motion everywhere, `chosen` is vectors, and nothing has been uncovered.
//
// takes    chosen [H, W] motion, uncovered · light, guide [H, W] · denoised_before [H, W]
// returns  past [H, W] rgb, ON_SCREEN and UNCOVERED
#pragma constants HISTORY DUAL
#include "image.glsl"
#include "on_screen.glsl"
#include "past.glsl"
#include "albedo.glsl"

layout(std430, binding = 0) readonly restrict buffer Chosen { vec4 chosen[]; };
layout(std430, binding = 1) readonly restrict buffer Light { vec4 light[]; };
layout(std430, binding = 2) readonly restrict buffer Guide { vec4 guide[]; };
layout(std430, binding = 3) readonly restrict buffer DenoisedBefore { vec4 denoised_before[]; };
layout(std430, binding = 4) writeonly restrict buffer Past { vec4 past[]; };

vec3 value(ivec2 pixel) {
    return denoised_before[at(pixel, size)].rgb;
}
#define TYPE vec3
#include "look_up.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size), flags = 0;
    vec3 rgb = light[i].rgb * divisor(guide[i]);
#if HISTORY
    vec2 target = vec2(pixel) + chosen[i].xy;
    if (DUAL == 1 && chosen[i].z != 0.0) flags |= UNCOVERED;
    if (on_screen(target)) {
        flags |= ON_SCREEN;
        rgb = look_up(clamp(target, vec2(0.0), vec2(size - 1)));
    }
#endif
    past[i] = vec4(rgb, float(flags));
}
