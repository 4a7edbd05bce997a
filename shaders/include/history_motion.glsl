// The motion that fetches history (motion_splat.history_motion): dual where a moving object has just uncovered the pixel,
// traditional elsewhere, or everywhere with DUAL 0.
//
//     dual(x) = -motion_next_previous(x + motion(x)),    fetched at the nearest pixel
#pragma constants DUAL

layout(std430, binding = 0) readonly restrict buffer Vectors { vec4 vectors[]; };  // [H, W]: motion, motion_next
layout(std430, binding = 1) readonly restrict buffer VectorsBefore { vec4 vectors_before[]; };  // of the previous frame

const float OCCLUSION_THRESHOLD = 0.5;  // pixels; as in motion.py

bool on_screen(vec2 target) {
    return all(greaterThanEqual(target, vec2(-0.5))) && all(lessThanEqual(target, vec2(size) - 0.5));
}

vec2 history_motion(ivec2 pixel, out bool uncovered) {
    vec2 motion = vectors[at(pixel, size)].xy;
    vec2 target = vec2(pixel) + motion;
    uncovered = false;
    if (DUAL == 0 || !on_screen(target)) return motion;

    ivec2 nearest = ivec2(floor(clamp(target, vec2(0.0), vec2(size - 1)) + 0.5));
    vec2 dual = -vectors_before[at(nearest, size)].zw;
    vec2 apart = dual - motion;
    uncovered = dot(apart, apart) > OCCLUSION_THRESHOLD * OCCLUSION_THRESHOLD;
    return uncovered ? dual : motion;
}
