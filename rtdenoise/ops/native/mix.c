// One picture of two, and of the previous one. The specification is ops/mix.py; CELL, DARK, FAR, LARGEST, NOISE, TELLS and
// UNCOVERED are those of constants.py. BEFORE and NOISY are 1 where there is a previous picture, and the frame, else 0.
#include "common.h"
#include "expm1.h"
#include "log1p.h"
#include "told.h"

typedef struct {
    Told sums;  // of both pictures; the frame may be NULL
    const float *before;  // [3, H, W], or NULL
    const float *trust, *held, *tells, *depth;  // [H, W]; the last three likewise
    float *out;           // [3, H, W]
    float share, least, word;
} Job;

// No share of the first where neither a pixel of row y nor one around it hit anything.
static inline void leave_the_sky(Job j, int y, float *share) {
    int W = j.sums.W;
    const float *here = j.depth + (int64_t)y * W, *above = y > 0 ? here - W : here, *below = y + 1 < j.sums.H ? here + W : here;
    float greatest[W + 2];  // of each column, with a border of nothing
    greatest[0] = greatest[W + 1] = 0;
#pragma omp simd
    for (int x = 0; x < W; x++) greatest[x + 1] = MAX(MAX(above[x], here[x]), below[x]);
#pragma omp simd
    for (int x = 0; x < W; x++) share[x] = MAX(MAX(greatest[x], greatest[x + 1]), greatest[x + 2]) > 0 ? share[x] : 0;
}

// What the frame tells of the pixels of row y, where it tells of others within the usual, as far as its word counts; `space` has
// SUMS · columns values.
static inline void bounded(Job j, int y, float *space, float *share) {
    const float *tells = j.tells + (int64_t)y * j.sums.W;
    told(j.sums, y, space, share);
#pragma omp simd
    for (int x = 0; x < j.sums.W; x++)
        share[x] = lerp(j.sums.usual, lerp(MIN(MAX(share[x], j.least), j.sums.usual), share[x], tells[x]), j.word);
}

// A row of one colour; `share` of the first picture in each pixel.
static inline void colour(Job j, int64_t row, int c, const float *share) {
    int64_t at = row + c * j.sums.plane;
    const float *first = j.sums.first + at, *other = j.sums.other + at, *before = BEFORE ? j.before + at : NULL;
    const float *trust = j.trust + row, *held = BEFORE ? j.held + row : NULL, *tells = NOISY ? j.tells + row : NULL;
    float *out = j.out + at, scale = j.sums.scale, part = j.share;
#pragma omp simd
    for (int x = 0; x < j.sums.W; x++) {
        float p = log1p_positive(scale * MAX(first[x], 0)), q = log1p_positive(scale * MAX(other[x], 0));
        if (NOISY) p = tells[x] < (float)TELLS ? q + MIN(MAX(p - q, -(float)UNCOVERED), (float)UNCOVERED) : p;
        float mixed = lerp(q, p, trust[x] * share[x]);
        if (BEFORE) {
            float apart = log1p_positive(scale * MAX(before[x], 0)) - mixed;
            mixed += trust[x] * part * held[x] * MIN(MAX(apart, -(float)FAR), (float)FAR);
        }
        out[x] = expm1_positive(mixed) / scale;
    }
}

// first, other, before, noisy, out [B, 3, H, W], trust, held, tells, depth [B, 1, H, W], scale, word [B]; depth and word may be
// NULL. cells and around have rows · columns · SUMS values, `space` (SUMS + 1) · W for each of `threads` threads.
void mix(const float *first, const float *other, const float *scale, const float *trust, const float *before, const float *held,
         const float *noisy, const float *tells, const float *depth, const float *word, float *cells, float *around,
         float *space, float *out, int B, int H, int W, float usual, float share, float least, int threads) {
    int64_t plane = (int64_t)H * W;
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
    for (int b = 0; b < B; b++) {
        int64_t at = b * plane;
        Told sums = {first + 3 * at, other + 3 * at, NOISY ? noisy + 3 * at : NULL, cells, around, scale[b], usual, plane,
                     H, W, rows, columns};
        Job j = {sums, BEFORE ? before + 3 * at : NULL, trust + at, BEFORE ? held + at : NULL, NOISY ? tells + at : NULL,
                 depth ? depth + at : NULL, out + 3 * at, share, least, word ? word[b] : 1};
        int heard = NOISY && j.word > 0;
        for (int step = heard ? 0 : 2; step < 3; step++) {
            int count = step < 2 ? rows : H;
#pragma omp parallel for num_threads(threads) schedule(static)
            for (int t = 0; t < threads; t++) {
                float *own = space + (int64_t)t * (SUMS + 1) * W, *shares = own + SUMS * W;
                for (int i = (int64_t)count * t / threads; i < (int64_t)count * (t + 1) / threads; i++) {
                    if (step == 0) terms(sums, i, own);
                    if (step == 1) smooth(sums, i);
                    if (step < 2) continue;
                    for (int x = 0; x < W; x++) shares[x] = usual;
                    if (heard) bounded(j, i, own, shares);
                    if (depth) leave_the_sky(j, i, shares);
                    for (int c = 0; c < 3; c++) colour(j, (int64_t)i * W, c, shares);
                }
            }
        }
    }
}
