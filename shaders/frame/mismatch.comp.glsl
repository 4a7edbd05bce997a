#version 430
// Whether history still belongs to this shot (history.mismatch): count the pixels whose surface was on the screen, those among
// them for which the nearest pixel of the previous frame shows another surface, and the pixels that differ from the one beside
// and move as it does, and whether any of the first moves. AROUND 1: the second number is of those for which the eight
// pixels around that one do so, too.
#pragma constants AROUND CUT_ALIKE DEPTH_TOLERANCE MIN_NORMAL_COSINE
#include "image.glsl"
#include "on_screen.glsl"
#include "alike.glsl"

#pragma reads vec4 vectors, vec4 surface, vec4 surface_before  // [H, W]
#pragma changes uint counts                                    // [4], 0 before

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size);
    if (pixel.x + 1 < size.x && !alike(surface[i], surface[i + 1], DEPTH_TOLERANCE, MIN_NORMAL_COSINE)) {
        vec2 apart = vectors[i + 1].xy - vectors[i].xy;
        if (dot(apart, apart) < CUT_ALIKE * CUT_ALIKE) atomicAdd(counts[2], 1u);
    }
    vec2 target = vec2(pixel) + vectors[i].xy;
    if (!on_screen(target)) return;
    atomicAdd(counts[0], 1u);
    if (vectors[i].xy != vec2(0)) counts[3] = 1u;
    for (int y = -AROUND; y <= AROUND; ++y)
        for (int x = -AROUND; x <= AROUND; ++x) {
            vec4 before = surface_before[at(nearest(target + vec2(x, y)), size)];
            if (alike(surface[i], before, DEPTH_TOLERANCE, MIN_NORMAL_COSINE)) return;
        }
    atomicAdd(counts[1], 1u);
}
