#version 430
// The motion that fetches history (splat.history_motion): dual where a moving object has just uncovered the pixel,
// traditional elsewhere.
//
//     dual(x) = -motion_next_before(x + motion(x)),    fetched at the nearest pixel
#pragma constants OCCLUSION_THRESHOLD
#include "image.glsl"
#include "on_screen.glsl"

#pragma reads vec4 vectors         // [H, W] motion, motion_next
#pragma reads vec4 vectors_before  // the same, of the previous frame
#pragma writes vec4 chosen         // [H, W] motion, 1 where the pixel has been uncovered, 0

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    vec2 motion = vectors[at(pixel, size)].xy, target = vec2(pixel) + motion;
    bool uncovered = false;
    if (on_screen(target)) {
        vec2 dual = -vectors_before[at(nearest(target), size)].zw, apart = dual - motion;
        uncovered = dot(apart, apart) > OCCLUSION_THRESHOLD * OCCLUSION_THRESHOLD;
        if (uncovered) motion = dual;
    }
    chosen[at(pixel, size)] = vec4(motion, uncovered ? 1.0 : 0.0, 0.0);
}
