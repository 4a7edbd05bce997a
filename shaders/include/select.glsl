// Select the value of a given rank, by one work group of GROUP_X invocations together: digit by digit, since floats ≥ 0 have
// the order of their bits; -0, which a driver may make of a clamped value, counts as 0. `float value(int i)` is defined before
// this file is included.
#pragma constants GROUP_X
layout(local_size_x = GROUP_X) in;

shared uint bins[256];
shared uint digit, rank_within;

// The value at position `rank` of value(0) … value(count - 1) in ascending order; `equals` of those before it are equal to it.
float select(int count, uint rank, out uint equals) {
    int lane = int(gl_LocalInvocationIndex);
    uint leading = 0u, mask = 0u;
    for (int shift = 24; shift >= 0; shift -= 8) {
        for (int i = lane; i < 256; i += GROUP_X) bins[i] = 0u;
        barrier();
        for (int i = lane; i < count; i += GROUP_X) {
            uint bits = floatBitsToUint(value(i)) & 0x7fffffffu;
            if ((bits & mask) == leading) atomicAdd(bins[(bits >> shift) & 255u], 1u);
        }
        barrier();
        for (int i = lane; i < 256; i += GROUP_X) {
            uint below = 0u;
            for (int j = 0; j < i; ++j) below += bins[j];
            if (below <= rank && rank < below + bins[i]) {
                digit = uint(i);
                rank_within = rank - below;
            }
        }
        barrier();
        rank = rank_within;
        leading |= digit << shift;
        mask |= 255u << shift;
        barrier();
    }
    equals = rank;
    return uintBitsToFloat(leading);
}
