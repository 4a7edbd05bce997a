#version 430
// Turn winners into motion, and close cracks: where another surface than the previous one has landed, take the motion of the
// closest pixel, at most MAX_CRACK_DISTANCE away, that shows the previous surface and received its own.
#pragma constants DEPTH_TOLERANCE MAX_CRACK_DISTANCE OFF_SCREEN
#include "splat.glsl"

#pragma reads uint best, uint winner  // [H, W]
#pragma writes vec4 vectors_before    // [H, W] 0, motion_next of the previous frame

bool landed(int i) { return winner[i] != NOTHING; }
bool fits(int i) { return landed(i) && uintBitsToFloat(best[i]) <= DEPTH_TOLERANCE; }

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    const int REACH = MAX_CRACK_DISTANCE;
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
