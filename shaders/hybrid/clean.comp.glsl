#version 430
// Footprints with the albedo and the normal that networks have filtered (models.pixel_network.clean); what is beside them stays
// as it is. One invocation per pixel of the image.
#pragma parameters ivec2 padded
#include "image.glsl"
#include "activations.glsl"
#include "srgb.glsl"

#pragma reads vec4 shown                 // [3, H, W] rgb, frames · albedo, trust · normal, stays
#pragma reads FOUR albedo, FOUR normal   // [1, padded] what the networks wrote, ≥ 0
#pragma writes vec4 result               // as `shown`

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size), wrote = at(pixel, padded), plane = size.x * size.y;
    vec3 colour = srgb_decoded(min(unpacked(albedo[wrote]).rgb, 1.0));
    vec3 direction = 2.0 * min(unpacked(normal[wrote]).xyz, 1.0) - 1.0;
    result[i] = shown[i];
    result[i + plane] = vec4(colour, shown[i + plane].w);
    result[i + 2 * plane] = vec4(direction, shown[i + 2 * plane].w);
}
