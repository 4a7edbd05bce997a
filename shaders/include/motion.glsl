// Where motion vectors point.
layout(std430, binding = 1) readonly restrict buffer Motion { float motion[]; };  // [B, 2, H, W] (x, y) in pixels

// A motion that is not finite counts as zero. Tested by its bits: isnan and isinf may be optimised away.
float finite_or_zero(float v) {
    return (floatBitsToUint(v) & 0x7f800000u) == 0x7f800000u ? 0.0 : v;
}

// pixel + motion(pixel), clamped to the pixel centres of the image; pixel (0, 0) is at (0, 0).
vec2 target(int b, ivec2 pixel) {
    float x = finite_or_zero(motion[at(b, 0, pixel, 2, size)]);
    float y = finite_or_zero(motion[at(b, 1, pixel, 2, size)]);
    return clamp(vec2(pixel) + vec2(x, y), vec2(0.0), vec2(size - 1));
}
