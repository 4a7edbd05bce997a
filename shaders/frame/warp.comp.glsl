#version 430
// The previous output, where it was: bilinear; where that is off the screen, and in a first frame (HISTORY 0), the noise.
//
// DUAL 0: traditional motion everywhere, `chosen` is vectors, and nothing has been uncovered.
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

vec3 before(int x, int y) {
    return denoised_before[at(ivec2(x, y), size)].rgb;
}

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
        target = clamp(target, vec2(0.0), vec2(size - 1));
        ivec2 p0 = ivec2(floor(target)), p1 = min(p0 + 1, size - 1);
        vec2 f = target - vec2(p0);
        vec3 top = before(p0.x, p0.y) * (1.0 - f.x) + before(p1.x, p0.y) * f.x;
        vec3 bottom = before(p0.x, p1.y) * (1.0 - f.x) + before(p1.x, p1.y) * f.x;
        rgb = top * (1.0 - f.y) + bottom * f.y;
    }
#endif
    past[i] = vec4(rgb, float(flags));
}
