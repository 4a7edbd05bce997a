#version 430
// The previous output, reprojected; the noisy radiance where it was off the screen, and where something that shone by itself has
// left, as that output has spread its light there (ops.glow.left_by_glow).
//
// CUBIC: Catmull-Rom, else bilinear. DUAL 0: `chosen` holds traditional motion, and nothing has been uncovered. MEANS: there is a
// mean of albedo.
#pragma constants DUAL MEANS
#include "image.glsl"
#include "on_screen.glsl"
#include "past.glsl"
#include "albedo.glsl"
#include "glow.glsl"

#pragma reads vec4 chosen              // [H, W] motion, uncovered
#pragma reads vec4 light, vec4 guide   // [H, W]
#pragma reads vec4 denoised_before     // [H, W] rgb
#pragma reads vec4 mean_albedo_before  // [H, W] rgb; not read without MEANS
#pragma writes vec4 past               // [H, W] rgb, flags

GLOW(glows, guide)
GLOW(shone, mean_albedo_before)

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
    ivec2 nearest = ivec2(floor(clamp(target, vec2(0.0), vec2(size - 1)) + 0.5));
    bool left = MEANS == 1 && on_screen(target) && shone(nearest) && !glows(pixel);
    if (on_screen(target) && !left) {
        flags |= ON_SCREEN;
        rgb = look_up(clamp(target, vec2(0.0), vec2(size - 1)));
    }
    past[i] = vec4(rgb, float(flags));
}
