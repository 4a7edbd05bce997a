// Softmax over the taps of a KERNEL×KERNEL window that lie inside an image:
//
//     weight[k] ∝ exp(logit(k)),    k = dy·KERNEL + dx, at pixel corner + (dx, dy)
//
// `float logit(int k)` is defined before this file is included.
#pragma constants KERNEL

const int TAPS = KERNEL * KERNEL;
const float LOWEST = -3.402823466e38;

float weight[TAPS];

ivec2 tap(int k) {
    return ivec2(k % KERNEL, k / KERNEL);
}

// Sets `weight`, 0 for taps outside of `extent`, and returns the sum of the weights, which the caller divides by.
float softmax(ivec2 corner, ivec2 extent) {
    // The maximum is taken over the taps inside only: a tap outside must not push the others below the range of exp.
    float greatest = LOWEST, total = 0.0;
    for (int k = 0; k < TAPS; ++k) {
        weight[k] = inside(corner + tap(k), extent) ? logit(k) : LOWEST;
        greatest = max(greatest, weight[k]);
    }
    for (int k = 0; k < TAPS; ++k) {
        weight[k] = inside(corner + tap(k), extent) ? exp(weight[k] - greatest) : 0.0;
        total += weight[k];
    }
    return total;
}
