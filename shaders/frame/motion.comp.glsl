#version 430
// Motion vectors as they come, made fit (sanitise.sanitise): what is not finite leads off the screen.
//
// takes    motion, motion_next [2, H, W] in pixels
// returns  vectors [H, W]: motion, motion_next
#include "image.glsl"
#include "finite.glsl"

layout(std430, binding = 0) readonly restrict buffer Motion { float motion[]; };
layout(std430, binding = 1) readonly restrict buffer MotionNext { float motion_next[]; };
layout(std430, binding = 2) writeonly restrict buffer Vectors { vec4 vectors[]; };

const float OFF_SCREEN = 1e4;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int x = at(pixel, size), y = x + size.x * size.y;
    vectors[x] = vec4(
        finite_or(motion[x], OFF_SCREEN), finite_or(motion[y], OFF_SCREEN),
        finite_or(motion_next[x], OFF_SCREEN), finite_or(motion_next[y], OFF_SCREEN)
    );
}
