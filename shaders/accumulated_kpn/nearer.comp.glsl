#version 430
// A kept frame as from a camera that has gone ahead by so much (ops.kept.kept_nearer).
#pragma constants RECALL_DEPTH
#include "image.glsl"
#include "bfloat16.glsl"
#include "nearer.glsl"

#pragma reads uint kept      // [words, H, W] as `keep` writes it
#pragma writes uint shifted  // likewise

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;
    int i = at(pixel, size) + int(gl_GlobalInvocationID.z) * size.x * size.y;
    uint word = kept[i];
    if (int(gl_GlobalInvocationID.z) == RECALL_DEPTH) {
        vec2 halves = unpacked_two(word);
        word = word & 0xffffu | half_bits(nearer(halves.y)) << 16;
    }
    shifted[i] = word;
}
