#version 430
// Give the texture back. Albedo has one sample a pixel too: its mean is nearer to a converged picture, but for what has just
// changed, and the network says where that is.
//
//     now = max(0, composed) · divisor(sharp · albedo + (1 - sharp) · mean_albedo)
//
// takes    features, weights, biases: the head, the logit of sharp · composed [H, W] rgb · guide, mean_albedo [H, W]
// returns  now [H, W] rgb
#define PARAMETERS PARAMETER(ivec2, feature_size) PARAMETER(int, groups)
#include "image.glsl"
#include "albedo.glsl"
#define ROWS 1
#include "head.glsl"

layout(std430, binding = 3) readonly restrict buffer Composed { vec4 composed[]; };
layout(std430, binding = 4) readonly restrict buffer Guide { vec4 guide[]; };
layout(std430, binding = 5) readonly restrict buffer MeanAlbedo { vec4 mean_albedo[]; };
layout(std430, binding = 6) writeonly restrict buffer Now { vec4 now[]; };

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    vec4 rows[FOURS];
    predict(pixel, rows);
    int i = at(pixel, size);
    float sharp = sigmoid(rows[0].x);
    vec3 albedo = sharp * guide[i].rgb + (1.0 - sharp) * mean_albedo[i].rgb;
    now[i] = vec4(max(composed[i].rgb, 0.0) * divisor(vec4(albedo, guide[i].w)), 1.0);
}
