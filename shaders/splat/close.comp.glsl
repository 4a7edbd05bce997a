#version 430
// What landed where, and the cracks closed: where what landed is not the surface that was there, the closest pixel of that
// surface, REACH away at most, that received its own says how it moves.
//
// takes    vectors, surface, surface_before [H, W] · best, winner [H, W]
// returns  vectors_before [H, W]: 0, motion_next of the previous frame
#include "splat.glsl"

layout(std430, binding = 3) readonly restrict buffer Best { uint best[]; };
layout(std430, binding = 4) readonly restrict buffer Winner { uint winner[]; };
layout(std430, binding = 5) writeonly restrict buffer VectorsBefore { vec4 vectors_before[]; };

const float OFF_SCREEN = 1e4, DEPTH_TOLERANCE = 0.1;
const int REACH = 2;

bool landed(int i) { return winner[i] != NOTHING; }
bool fits(int i) { return landed(i) && uintBitsToFloat(best[i]) <= DEPTH_TOLERANCE; }

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int here = at(pixel, size), from = here;
    if (landed(here) && !fits(here)) {
        int closest = 2 * REACH * REACH + 1;  // squared distance
        for (int dy = -REACH; dy <= REACH; ++dy) {
            for (int dx = -REACH; dx <= REACH; ++dx) {
                ivec2 p = pixel + ivec2(dx, dy);
                int distance = dx * dx + dy * dy;
                if (distance >= closest || !inside(p, size)) continue;
                int i = at(p, size);
                if (!fits(i) || mismatch(surface_before[i].w, surface_before[here].w) > DEPTH_TOLERANCE) continue;
                closest = distance;
                from = i;
            }
        }
    }
    vec2 motion_next = landed(from) ? -vectors[winner[from]].xy : vec2(OFF_SCREEN);
    vectors_before[here] = vec4(0.0, 0.0, motion_next);
}
