// A head whose first KERNEL² rows are the logits of a kernel; the row after them, where there is one, is the logit of a
// blend weight.
#pragma constants KERNEL
#include "head.glsl"

float logit(int k) {
    return row(k);
}

// In [0, 1].
float blend_weight() {
    return sigmoid(row(KERNEL * KERNEL));
}
