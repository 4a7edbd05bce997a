#version 430
// Write into a kept frame how far light was reset to it: later frames count older ones so much less (ops.recall). With DUAL
// wholly where something else, that is alike, was before what has been uncovered (ops.passed).
#pragma constants RECALL_RESET DUAL DEPTH_TOLERANCE MIN_NORMAL_COSINE
#include "image.glsl"
#include "bfloat16.glsl"
#include "giving_way.glsl"
#include "alike.glsl"
#include "on_screen.glsl"

#pragma reads float reset                        // [H, W] as the network said
#pragma reads vec4 chosen                        // [H, W] motion, 1 where the pixel has been uncovered
#pragma reads vec4 vectors                       // [H, W] motion, motion_next
#pragma reads vec4 surface, vec4 surface_before  // [H, W] normal, depth
#pragma changes uint kept                        // [5, H, W] as `keep` writes it

bool passed(ivec2 pixel, int i) {
    if (DUAL == 0 || chosen[i].z == 0.0) return false;
    vec4 before = surface_before[at(nearest(vec2(pixel) + vectors[i].xy), size)];  // on the screen: it was uncovered
    return alike(surface[i], before, DEPTH_TOLERANCE, MIN_NORMAL_COSINE);
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size);
    kept[i + RECALL_RESET * size.x * size.y] |= half_bits(passed(pixel, i) ? 1.0 : giving_way(reset[i], pixel)) << 16;
}
