#version 430
// Sanitise motion vectors (sanitise.sanitise): those that are not finite lead off the screen.
#pragma constants OFF_SCREEN
#include "image.glsl"
#include "finite.glsl"

#pragma reads float motion, float motion_next  // [2, H, W] in pixels
#pragma writes vec4 vectors                    // [H, W] motion, motion_next

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int x = at(pixel, size), y = x + size.x * size.y;
    vectors[x] = vec4(
        finite_or(motion[x], OFF_SCREEN), finite_or(motion[y], OFF_SCREEN),
        finite_or(motion_next[x], OFF_SCREEN), finite_or(motion_next[y], OFF_SCREEN)
    );
}
