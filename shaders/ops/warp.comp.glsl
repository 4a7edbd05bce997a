#version 430
// Reprojection: out(p) = image(p + motion(p)), bilinear, or with CUBIC Catmull-Rom. With (u, v) the clamped target, x0 = ⌊u⌋,
// x1 = min(x0 + 1, W-1), f = u - x0, and y0, y1, g alike for v, bilinear is
//
//     out[b,c,y,x] = (1-g)·((1-f)·image[b,c,y0,x0] + f·image[b,c,y0,x1])
//                  +    g ·((1-f)·image[b,c,y1,x0] + f·image[b,c,y1,x1])
//
// takes    image [B, CHANNELS, H, W] · motion [B, 2, H, W]
// returns  result [B, CHANNELS, H, W]
#pragma constants CHANNELS
#include "tensor.glsl"
#include "motion.glsl"

layout(std430, binding = 0) readonly restrict buffer Image { float image[]; };
layout(std430, binding = 2) writeonly restrict buffer Result { float result[]; };

int b, c;  // the plane that is looked up in

float value(ivec2 pixel) {
    return image[at(b, c, pixel, CHANNELS, size)];
}
#define TYPE float
#include "look_up.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    vec2 uv = target(b, pixel);
    for (c = 0; c < CHANNELS; ++c) result[at(b, c, pixel, CHANNELS, size)] = look_up(uv);
}
