// Depth less `by`, of what was hit; what lies behind the camera then is as near as can be.
#pragma parameters float by

float nearer(float depth) {
    return depth > 0.0 ? max(depth - by, 1.17549435e-38) : depth;
}
