#version 430
// The inputs of the networks that filter albedo and normal: albedo on the sRGB curve, and normals in [0, 1]
// (models.pixel_network.clean). One invocation per pixel of the padded results, which are zero beyond the image.
#pragma parameters ivec2 image_size
#include "image.glsl"
#include "activations.glsl"
#include "srgb.glsl"

#pragma reads vec4 shown                  // [3, image_size] rgb, frames · albedo, trust · normal, stays
#pragma writes FOUR albedo, FOUR normal   // [1, size]

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    vec3 colour = vec3(0.0), direction = vec3(0.0);
    if (inside(pixel, image_size)) {
        int i = at(pixel, image_size), plane = image_size.x * image_size.y;
        colour = srgb_encoded(min(shown[i + plane].rgb, 1.0));
        direction = clamp(0.5 * shown[i + 2 * plane].xyz + 0.5, 0.0, 1.0);
    }
    int o = at(pixel, size);
    albedo[o] = packed_four(vec4(colour, 0.0));
    normal[o] = packed_four(vec4(direction, 0.0));
}
