// exp(x) - 1 for x ≥ 0, as 2ⁿ (exp(r) - 1) + 2ⁿ - 1 with |r| ≤ ln 2 / 2: small x keep their digits.
static inline float expm1_positive(float x) {
    float whole = x * 1.44269504f + ROUND, n = whole - ROUND;
    float r = fmaf(n, -1.42860677e-6f, fmaf(n, -0.693145752f, x)), p = 1.9875691e-4f;
    p = fmaf(p, r, 1.3981999e-3f);
    p = fmaf(p, r, 8.3334519e-3f);
    p = fmaf(p, r, 4.1665796e-2f);
    p = fmaf(p, r, 1.6666665e-1f);
    p = fmaf(p, r, 5.0000001e-1f);
    float two = from_bits((uint32_t)((int32_t)n + 127) << 23);
    float y = fmaf(two, fmaf(p * r, r, r), two - 1);
    return x < 88 ? y : INFINITY;
}
