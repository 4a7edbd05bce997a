#version 430
// Bid for targets: CLAIM 0 finds the smallest mismatch at every target, CLAIM 1 the first of the pixels that have it.
#pragma constants CLAIM
#include "splat.glsl"
#include "on_screen.glsl"

#pragma changes uint best    // [H, W] the smallest mismatch, as bits; NOTHING before CLAIM 0
#pragma changes uint winner  // [H, W] the pixel that has it; NOTHING before CLAIM 0

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
