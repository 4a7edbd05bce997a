// A value, or `otherwise` where it is NaN or Inf. Tested by its bits: isnan and isinf may be optimised away.
float finite_or(float v, float otherwise) {
    return (floatBitsToUint(v) & 0x7f800000u) == 0x7f800000u ? otherwise : v;
}
