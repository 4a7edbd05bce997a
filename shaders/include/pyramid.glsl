// Geometry of the image pyramid: coarse cell q covers the fine pixels 2q .. 2q+1 that exist.
ivec2 coarse_size() {
    return (size + 1) / 2;
}
