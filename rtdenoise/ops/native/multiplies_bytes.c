// The instructions that this CPU has for the products of convolve_bytes.c: 2 for those of bytes, 1 for those of pairs of 16 bits,
// else 0.
int multiplies_bytes(void) {
#if defined __AVX512VNNI__ || defined __AVXVNNI__
    return 2;
#elif defined __AVX2__
    return 1;
#else
    return 0;
#endif
}
