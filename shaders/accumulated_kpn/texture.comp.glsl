#version 430
// Give the texture back. Albedo has one sample per pixel too: its running mean is closer to a converged picture except where
// the picture has just changed, and there the network predicts a large `sharp`.
//
//     now = max(0, composed) · divisor(sharp · albedo + (1 - sharp) · mean_albedo)
#include "image.glsl"
#include "albedo.glsl"
#include "shares.glsl"

#pragma reads vec4 composed                 // [H, W] rgb
#pragma reads vec4 guide, vec4 mean_albedo  // [H, W]
#pragma writes vec4 now                     // [H, W] rgb

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    predict(pixel);
    int i = at(pixel, size);
    float sharp = sigmoid(row(SHARP));
    vec3 albedo = sharp * guide[i].rgb + (1.0 - sharp) * mean_albedo[i].rgb;
    now[i] = vec4(max(composed[i].rgb, 0.0) * divisor(vec4(albedo, guide[i].w)), 1.0);
}
