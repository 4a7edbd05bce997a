// log(1 + x) for x ≥ 0, within some ulp; branch-free. log(u) = e · ln 2 + log(1 + f) with √½ ≤ 1 + f < √2 (coefficients of
// Cephes' logf). Near 1 the sum u = 1 + x loses digits of x; there f is x itself.
static inline float log1p_positive(float x) {
    uint32_t bits = bits_of(1 + x);
    int32_t e = (int32_t)(bits - 0x3f3504f3) >> 23;
    float f = e == 0 ? x : from_bits(bits - ((uint32_t)e << 23)) - 1, p = 7.0376836292e-2f;
    p = fmaf(p, f, -1.1514610310e-1f);
    p = fmaf(p, f, 1.1676998740e-1f);
    p = fmaf(p, f, -1.2420140846e-1f);
    p = fmaf(p, f, 1.4249322787e-1f);
    p = fmaf(p, f, -1.6668057665e-1f);
    p = fmaf(p, f, 2.0000714765e-1f);
    p = fmaf(p, f, -2.4999993993e-1f);
    p = fmaf(p, f, 3.3333331174e-1f);
    p = fmaf(p, f, -0.5f);
    return fmaf((float)e, 0.693147181f, fmaf(p, f * f, f));
}
