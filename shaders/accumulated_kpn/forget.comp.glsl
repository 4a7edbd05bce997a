#version 430
// Write into a kept frame how far light was reset to it: later frames count older ones so much less (ops.recall).
#pragma constants RECALL_RESET
#include "image.glsl"
#include "bfloat16.glsl"
#include "giving_way.glsl"

#pragma reads float reset  // [H, W] as the network said
#pragma changes uint kept  // [5, H, W] as `keep` writes it

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size);
    kept[i + RECALL_RESET * size.x * size.y] |= half_bits(giving_way(reset[i], pixel)) << 16;
}
