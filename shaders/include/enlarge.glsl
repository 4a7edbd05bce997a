// U of eq. 4: bilinear ×2. In each direction the pixel's own cell weighs 3/4 and the nearest other cell 1/4; borders are
// repeated.
//
// TYPE and `TYPE coarse_value(ivec2 cell)` are defined before this file is included.
#include "pyramid.glsl"

TYPE enlarged(ivec2 pixel) {
    ivec2 p = pixel / 2;
    ivec2 q = clamp(p + 2 * (pixel & 1) - 1, ivec2(0), coarse_size() - 1);
    TYPE near = 0.75 * coarse_value(p) + 0.25 * coarse_value(ivec2(q.x, p.y));
    TYPE far = 0.75 * coarse_value(ivec2(p.x, q.y)) + 0.25 * coarse_value(q);
    return 0.75 * near + 0.25 * far;
}
