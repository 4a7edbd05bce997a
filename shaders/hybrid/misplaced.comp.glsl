#version 430
// How much less lookups off the pixel count (models.past.misplaced), from the noise of a frame (exposure.noise_level): the
// median over windows of NOISE_WINDOW² pixels, all of which hit something, of the variance of their light over the square of
// its mean. One work group for all windows, whose values are in `relative`; below 0 there is none. WIDE: the frame's pixel
// filter is (Frame.wide_filter).
#pragma constants WIDE RECALL_NOISY RECALL_MISPLACED RECALL_MISPLACED_WIDE
#pragma parameters int count
#pragma reads float relative    // [count]
#pragma writes float misplaced  // [1]

float value(int i) {
    return relative[i] < 0.0 ? 3e38 : relative[i];  // the last ones
}
#include "select.glsl"

shared uint valid;

void main() {
    int lane = int(gl_LocalInvocationIndex);
    if (lane == 0) valid = 0u;
    barrier();
    for (int i = lane; i < count; i += GROUP_X)
        if (relative[i] >= 0.0) atomicAdd(valid, 1u);
    barrier();
    uint equals, rank = (max(valid, 1u) - 1u) / 2u;
    float noise = select(count, rank, equals);
    float share = WIDE == 1 ? RECALL_MISPLACED_WIDE : RECALL_MISPLACED;
    if (lane == 0) misplaced[0] = share * max(1.0 / max(noise, 1e-6) - 1.0 / RECALL_NOISY, 0.0);
}
