// Whether this CPU has instructions for the products of convolve_bytes.c.
int multiplies_bytes(void) {
#if defined __AVX512VNNI__ || defined __AVXVNNI__
    return 1;
#else
    return 0;
#endif
}
