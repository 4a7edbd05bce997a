// A frame as it is kept. The specification is ops/keep.py.
#include "common.h"
#include "kept.h"
#include "kept_rows.h"

static inline uint32_t half(float x) {  // bfloat16, the nearest, even in between
    uint32_t bits = bits_of(x);
    return isnan(x) ? 0x7fc0 : (bits + 0x7fff + (bits >> 16 & 1)) >> 16;
}

// light [B, 3, H, W], depth [B, 1, H, W], normal [B, 3, H, W], reset [B, 1, H, W], motion [B, 2, H, W], kept [B, H, W, LESS];
// or with albedo [B, 3, H, W], which may be NULL, [B, H, W, WORDS]; all contiguous.
void keep(const float *light, const float *depth, const float *normal, const float *reset, const float *motion,
          const float *albedo, uint32_t *kept, int B, int H, int W, float depth_tolerance, float speed, int threads) {
    int64_t plane = (int64_t)H * W;
    int words = albedo ? WORDS : LESS;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int line = 0; line < B * H; line++) {
        int64_t b = line / H, y = line % H, first = y * W;
        const float *l = light + 3 * b * plane + first, *d = depth + b * plane + first, *r = reset + b * plane + first;
        const float *n = normal + 3 * b * plane + first, *m = motion + 2 * b * plane + first;
        const float *a = albedo ? albedo + 3 * b * plane + first : NULL;
        uint32_t *out = kept + words * (b * plane + first);
        for (int from = 0; from < W; from += BLOCK) {
            int many = MIN(BLOCK, W - from);
            float u[BLOCK], v[BLOCK], nearest[BLOCK];
            if (a) edges(m - first, d - first, plane, H, W, y, from, many, depth_tolerance, speed, u, v, nearest);
            for (int part = 0; part < many; part += WORDS) {
                int size = MIN(WORDS, many - part);
                row rows[WORDS];
                uint32_t found[WORDS][WORDS] = {{0}};
#pragma omp simd
                for (int x = 0; x < size; x++) {
                    int i = from + part + x;
                    found[0][x] = half(l[i]) | half(l[plane + i]) << 16;
                    found[1][x] = half(l[2 * plane + i]) | half(d[i]) << 16;
                    found[2][x] = half(n[i]) | half(n[plane + i]) << 16;
                    found[3][x] = half(n[2 * plane + i]) | half(r[i]) << 16;
                    found[4][x] = half(m[i]) | half(m[plane + i]) << 16;
                }
                for (int x = 0; a && x < size; x++) {
                    int i = from + part + x;
                    found[5][x] = half(a[i]) | half(a[plane + i]) << 16;
                    found[6][x] = half(a[2 * plane + i]) | half(u[part + x]) << 16;
                    found[7][x] = half(v[part + x]);
                }
                memcpy(rows, found, sizeof rows);
                transpose(rows);
                for (int x = 0; x < size; x++, out += words) memcpy(out, rows + x, words * sizeof *out);
            }
        }
    }
}
