#version 430
// The previous output, reprojected; the noisy radiance where it was off the screen.
//
// CUBIC: Catmull-Rom, else bilinear. DUAL 0: `chosen` holds traditional motion, and nothing has been uncovered.
#pragma constants DUAL
#include "image.glsl"
#include "on_screen.glsl"
#include "past.glsl"
#include "albedo.glsl"

#pragma reads vec4 chosen              // [H, W] motion, uncovered
#pragma reads vec4 light, vec4 guide   // [H, W]
#pragma reads vec4 denoised_before     // [H, W] rgb
#pragma writes vec4 past               // [H, W] rgb, flags

#define TYPE vec3
vec3 value(ivec2 pixel) {
    return denoised_before[at(pixel, size)].rgb;
}
#include "look_up.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size), flags = DUAL == 1 && chosen[i].z != 0.0 ? UNCOVERED : 0;
    vec2 target = vec2(pixel) + chosen[i].xy;
    vec3 rgb = light[i].rgb * divisor(guide[i]);
    if (on_screen(target)) {
        flags |= ON_SCREEN;
        rgb = look_up(clamp(target, vec2(0.0), vec2(size - 1)));
    }
    past[i] = vec4(rgb, float(flags));
}
