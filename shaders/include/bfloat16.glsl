// Two bfloat16 in a word: the low half first.
uint half_bits(float v) {  // of a finite value: the nearest, even in between
    uint bits = floatBitsToUint(v);
    return (bits + 0x7fffu + (bits >> 16 & 1u)) >> 16;
}

uint packed_two(float low, float high) {
    return half_bits(low) | half_bits(high) << 16;
}

vec2 unpacked_two(uint word) {
    return vec2(uintBitsToFloat(word << 16), uintBitsToFloat(word & 0xffff0000u));
}
