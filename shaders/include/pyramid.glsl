// Geometry of the image pyramid: coarse cell q covers the fine pixels 2q .. 2q+1, as far as they exist.

ivec2 coarse_size() {
    return (size + 1) / 2;
}

// The cells that U of eq. 4 (bilinear ×2) takes for a fine pixel: in each direction the one it lies in, with weight 3/4, and
// the one it lies next to, with 1/4; beyond the border that is the same again.
struct Cells { ivec2 near; ivec2 far; };

Cells cells_of(ivec2 pixel) {
    ivec2 near = pixel / 2;
    ivec2 far = clamp(near + 2 * (pixel & 1) - 1, ivec2(0), coarse_size() - 1);
    return Cells(near, far);
}
