#version 430
// Light and depth of blocks of SHIFT_BLOCK² pixels.
#pragma constants SHIFT_BLOCK
#pragma parameters ivec2 image_size
#include "image.glsl"
#include "luminance.glsl"

#pragma reads vec4 picture, vec4 surface  // [image_size] rgb; normal, depth
#pragma writes vec4 blocks              // [size] mean luminance, greatest, greatest depth, least depth

void main() {
    ivec2 block = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(block, size)) return;

    float sum = 0.0, count = 0.0, greatest = 0.0, far = 0.0, near = 3e38;
    for (int k = 0; k < SHIFT_BLOCK * SHIFT_BLOCK; ++k) {
        ivec2 pixel = block * SHIFT_BLOCK + ivec2(k % SHIFT_BLOCK, k / SHIFT_BLOCK);
        if (!inside(pixel, image_size)) continue;
        int i = at(pixel, image_size);
        float light = luminance(picture[i].rgb);
        sum += light;
        count += 1.0;
        greatest = max(greatest, light);
        far = max(far, surface[i].w);
        near = min(near, surface[i].w);
    }
    blocks[at(block, size)] = vec4(sum / count, greatest, far, near);
}
