// An image at a target between its pixels: bilinear, or with CUBIC Catmull-Rom over 4×4 pixels, clamped to the range of the
// 2×2 around the target so that it does not overshoot.
//
// TYPE and `TYPE value(ivec2 pixel)` are defined before this file is included.
#pragma constants CUBIC

TYPE look_up(vec2 target) {
    ivec2 p0 = ivec2(floor(target));
    vec2 f = target - vec2(p0);
#if CUBIC
    mat2x4 weights;
    for (int k = 0; k < 2; ++k) {
        float t = f[k];
        weights[k] = vec4(t * (t * (1.0 - 0.5 * t) - 0.5), 1.0 + t * t * (1.5 * t - 2.5), t * (0.5 + t * (2.0 - 1.5 * t)),
                          t * t * (0.5 * t - 0.5));
    }
    TYPE sum = TYPE(0.0), least = value(p0), greatest = least;
    for (int j = 0; j < 4; ++j) {
        TYPE line = TYPE(0.0);
        for (int i = 0; i < 4; ++i) {
            TYPE tap = value(clamp(p0 + ivec2(i, j) - 1, ivec2(0), size - 1));
            line += weights[0][i] * tap;
            if (i % 3 != 0 && j % 3 != 0) {
                least = min(least, tap);
                greatest = max(greatest, tap);
            }
        }
        sum += weights[1][j] * line;
    }
    return clamp(sum, least, greatest);
#else
    ivec2 p1 = min(p0 + 1, size - 1);
    TYPE top = value(p0) * (1.0 - f.x) + value(ivec2(p1.x, p0.y)) * f.x;
    TYPE bottom = value(ivec2(p0.x, p1.y)) * (1.0 - f.x) + value(p1) * f.x;
    return top * (1.0 - f.y) + bottom * f.y;
#endif
}
