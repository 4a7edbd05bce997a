#version 430
// The motion that fetches history (motion_splat.history_motion): dual where a moving object has just uncovered the pixel,
// traditional elsewhere. Not run where that is known to be everywhere.
//
//     dual(x) = -motion_next_before(x + motion(x)),    fetched at the nearest pixel
//
// takes    vectors, vectors_before [H, W]: motion, motion_next of this frame and of the previous one
// returns  chosen [H, W]: motion, 1 where the pixel has been uncovered, 0
#include "image.glsl"
#include "on_screen.glsl"

layout(std430, binding = 0) readonly restrict buffer Vectors { vec4 vectors[]; };
layout(std430, binding = 1) readonly restrict buffer VectorsBefore { vec4 vectors_before[]; };
layout(std430, binding = 2) writeonly restrict buffer Chosen { vec4 chosen[]; };

const float OCCLUSION_THRESHOLD = 0.5;  // pixels; as in motion.py

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
