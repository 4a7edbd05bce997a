#version 430
// The previous output, where it was; off the screen the noise instead, like a first frame.
//
// takes    vectors, vectors_before [H, W] · light [H, W] · denoised_before [H, W]
// returns  past [H, W] rgb, VALID
#include "image.glsl"
#include "history_motion.glsl"
#include "past.glsl"

layout(std430, binding = 2) readonly restrict buffer Light { vec4 light[]; };
layout(std430, binding = 3) readonly restrict buffer DenoisedBefore { vec4 denoised_before[]; };
layout(std430, binding = 4) writeonly restrict buffer Past { vec4 past[]; };

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    bool uncovered;
    vec2 target = vec2(pixel) + history_motion(pixel, uncovered);
    vec3 rgb = light[at(pixel, size)].rgb;
    if (on_screen(target)) {
        target = clamp(target, vec2(0.0), vec2(size - 1));
        ivec2 p0 = ivec2(floor(target)), p1 = min(p0 + 1, size - 1);
        vec2 f = target - vec2(p0);
        vec3 top = denoised_before[at(p0, size)].rgb * (1.0 - f.x) + denoised_before[at(ivec2(p1.x, p0.y), size)].rgb * f.x;
        vec3 bottom = denoised_before[at(ivec2(p0.x, p1.y), size)].rgb * (1.0 - f.x) + denoised_before[at(p1, size)].rgb * f.x;
        rgb = top * (1.0 - f.y) + bottom * f.y;
    }
    past[at(pixel, size)] = vec4(rgb, float(VALID));
}
