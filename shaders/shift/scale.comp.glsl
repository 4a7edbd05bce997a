#version 430
// The exposure at which a picture's mean luminance becomes SHIFT_BRIGHTNESS (shift.displacement.compressed); one work group.
#pragma constants GROUP_X SHIFT_BRIGHTNESS
#pragma parameters int count, float pixels
#pragma reads float blocks  // [count] of `brightness`
#pragma writes float scale  // [1]

layout(local_size_x = GROUP_X) in;

shared float partial[GROUP_X];

void main() {
    int lane = int(gl_LocalInvocationIndex);
    partial[lane] = 0.0;
    for (int i = lane; i < count; i += GROUP_X) partial[lane] += blocks[i];
    for (int step = GROUP_X / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) partial[lane] += partial[lane + step];
    }
    if (lane == 0) scale[0] = SHIFT_BRIGHTNESS / max(partial[0] / pixels, 1e-12);
}
