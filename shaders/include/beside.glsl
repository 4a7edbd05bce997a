// A pixel and the four beside it, in the order of ops.recall.BESIDE, and how far away a surface is.
const ivec2 BESIDE[5] = ivec2[](ivec2(0, 0), ivec2(0, -1), ivec2(-1, 0), ivec2(1, 0), ivec2(0, 1));
const float NOWHERE = 3e38;  // the distance of what was not hit

// Pixel k of them; borders are repeated.
ivec2 beside(ivec2 pixel, int k) {
    return clamp(pixel + BESIDE[k], ivec2(0), size - 1);
}

float distance_of(float depth) {
    return depth > 0.0 ? depth : NOWHERE;
}
