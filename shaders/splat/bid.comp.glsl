#version 430
// Bid: with CLAIM 0 the least mismatch at every target, with CLAIM 1 the first of the pixels that have it.
//
// takes    vectors, surface, surface_before [H, W] · best, winner [H, W], before CLAIM 0 all NOTHING
// returns  best (CLAIM 0), winner (CLAIM 1)
#pragma constants CLAIM
#include "splat.glsl"
#include "on_screen.glsl"

layout(std430, binding = 3) restrict buffer Best { uint best[]; };
layout(std430, binding = 4) restrict buffer Winner { uint winner[]; };

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int p = at(pixel, size);
    vec2 target = vec2(pixel) + vectors[p].xy;
    if (!on_screen(target)) return;

    int t = at(nearest(target), size);
    uint bid = floatBitsToUint(mismatch(surface[p].w, surface_before[t].w));
#if CLAIM == 0
    atomicMin(best[t], bid);
#else
    if (bid == best[t]) atomicMin(winner[t], uint(p));
#endif
}
