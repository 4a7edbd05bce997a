#version 430
// Bilinear reprojection: out(p) = image(p + motion(p)). With (u, v) the clamped target, x0 = ⌊u⌋, x1 = min(x0 + 1, W-1),
// f = u - x0, and y0, y1, g alike for v:
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

float value(int b, int c, int x, int y) {
    return image[at(b, c, ivec2(x, y), CHANNELS, size)];
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    vec2 uv = target(b, pixel);
    ivec2 p0 = ivec2(floor(uv));
    ivec2 p1 = min(p0 + 1, size - 1);
    vec2 f = uv - vec2(p0);
    for (int c = 0; c < CHANNELS; ++c) {
        float top = value(b, c, p0.x, p0.y) * (1.0 - f.x) + value(b, c, p1.x, p0.y) * f.x;
        float bottom = value(b, c, p0.x, p1.y) * (1.0 - f.x) + value(b, c, p1.x, p1.y) * f.x;
        result[at(b, c, pixel, CHANNELS, size)] = top * (1.0 - f.y) + bottom * f.y;
    }
}
