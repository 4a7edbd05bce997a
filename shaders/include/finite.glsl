// A value, or `otherwise` where it is NaN or Inf. Tested by its bits: compilers may optimise isnan and isinf away.
float finite_or(float v, float otherwise) {
    return (floatBitsToUint(v) & 0x7f800000u) == 0x7f800000u ? otherwise : v;
}
