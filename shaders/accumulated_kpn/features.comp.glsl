#version 430
// The input of the network of accumulated_kpn: 21 channels, light compressed at one exposure, nearness and length in [0, 1].
// One invocation per pixel of the padded result, which repeats the border of the image.
//
// The channels are in another order than in torch (glsl.passes.FEATURE_ORDER). Those that may be zero everywhere come last and are
// then not written: GROUPS is 5 where nothing has been uncovered, 4 in a first frame, which does not read `running`.
#pragma constants GROUPS
#pragma parameters float longest  // frames after which the running mean forgets
#include "image.glsl"
#include "activations.glsl"
#include "network_input.glsl"
#include "past.glsl"

#pragma reads vec4 running, vec4 mean_albedo  // [image_size]
#pragma writes FOUR result  // [6, H, W]: noisy 3, nearness 1 · previous output 3, normal x · albedo 3, normal y · its running
                            // mean 3, normal z · running mean of light 3, length 1 · uncovered 1

void main() {
    ivec2 padded = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(padded, size)) return;

    int i = at(min(padded, image_size - 1), image_size), o = at(padded, size), plane = size.x * size.y;
    vec3 normal = surface[i].xyz;
    result[o] = packed_four(vec4(compress(light[i].rgb), nearness(surface[i].w)));
    result[o + plane] = packed_four(vec4(compress(past[i].rgb), normal.x));
    result[o + 2 * plane] = packed_four(vec4(guide[i].rgb, normal.y));
    result[o + 3 * plane] = packed_four(vec4(mean_albedo[i].rgb, normal.z));
    if (GROUPS > 4) result[o + 4 * plane] = packed_four(vec4(compress(running[i].rgb), running[i].w / longest));
    if (GROUPS > 5) result[o + 5 * plane] = packed_four(vec4(is_uncovered(past[i]) ? 1.0 : 0.0, 0.0, 0.0, 0.0));
}
