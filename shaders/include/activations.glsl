// Activations of the network: [⌈C/4⌉, H, W], four channels per element; missing channels are 0.
// HALF stores four float16 in 64 bits. Arithmetic is in float32 either way.
#pragma constants HALF

#if HALF
#define FOUR uvec2
vec4 unpacked(uvec2 four) { return vec4(unpackHalf2x16(four.x), unpackHalf2x16(four.y)); }
uvec2 packed_four(vec4 four) { return uvec2(packHalf2x16(four.xy), packHalf2x16(four.zw)); }
#else
#define FOUR vec4
vec4 unpacked(vec4 four) { return four; }
vec4 packed_four(vec4 four) { return four; }
#endif

// Index of activations[g, p.y, p.x].
int in_group(int g, ivec2 p, ivec2 extent) {
    return (g * extent.y + p.y) * extent.x + p.x;
}
