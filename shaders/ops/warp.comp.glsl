#version 430
// Reprojection: out(p) = image(p + motion(p)), bilinear, or with CUBIC Catmull-Rom. With (u, v) the clamped target, x0 = ⌊u⌋,
// x1 = min(x0 + 1, W-1), f = u - x0, and likewise y0, y1, g for v, bilinear is
//
//     out[b,c,y,x] = (1-g)·((1-f)·image[b,c,y0,x0] + f·image[b,c,y0,x1])
//                  +    g ·((1-f)·image[b,c,y1,x0] + f·image[b,c,y1,x1])
#pragma constants CHANNELS
#include "tensor.glsl"

#pragma reads float image    // [B, CHANNELS, H, W]
#include "motion.glsl"
#pragma writes float result  // [B, CHANNELS, H, W]

int b, c;  // the plane that is looked up in
#define TYPE float
float value(ivec2 pixel) {
    return image[at(b, c, pixel, CHANNELS, size)];
}
#include "look_up.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    vec2 uv = target(b, pixel);
    for (c = 0; c < CHANNELS; ++c) result[at(b, c, pixel, CHANNELS, size)] = look_up(uv);
}
