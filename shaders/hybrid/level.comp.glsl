#version 430
// How much less lookups off the pixel count (models.past.misplaced; of FEW samples as much as others), how far light is evened
// and how much the frame's word counts (models.hybrid.heard), from the noise of a frame (exposure.noise_level): the median over
// windows of NOISE_WINDOW² pixels, all of which hit something, of the variance of their light over the square of its mean. One
// work group for all windows, whose values are in `relative`; below 0 there is none. MORE: Frame.more_history.
#pragma constants FEW MORE EVENED_NOISE MIX_WORD_FROM MIX_WORD_WHOLE RECALL_NOISY RECALL_MISPLACED RECALL_MISPLACED_MORE
#pragma parameters int count
#pragma reads float relative    // [count]
#pragma writes float level      // [3] how much less lookups count; in [0, 1] how far light is evened, and how much the word counts

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
    float share = MORE == 1 ? RECALL_MISPLACED_MORE : RECALL_MISPLACED;
    if (lane == 0) {
        level[0] = FEW == 1 ? 0.0 : share * max(1.0 / max(noise, 1e-6) - 1.0 / RECALL_NOISY, 0.0);
        level[1] = min(noise / EVENED_NOISE, 1.0);
        level[2] = FEW == 1 ? clamp((noise - MIX_WORD_FROM) / (MIX_WORD_WHOLE - MIX_WORD_FROM), 0.0, 1.0) : 1.0;
    }
}
