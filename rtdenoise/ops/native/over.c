// Edges that move against what is behind them. The specification is ops/over.py; GLOSS is that of constants.py, TOLERANCE its
// DEPTH_TOLERANCE.
//
// Few pixels are such edges, so each row is searched first, and paths are followed for what was found alone.
#include "common.h"
#include "kept.h"

#define SEEN 9   // channels of a footprint
#define WORDS 8  // of a kept frame

typedef struct {
    const float *seen, *motion, *depth;        // planes of the current frame
    const float *const *now;                   // likewise
    const uint32_t *const *kept;               // K frames [H, W, WORDS]
    float *out, *coverage, apart, speed, light, same;
    int64_t plane;
    int K, H, W;
} Job;

// The pixel and the four beside it, in the order of ops/kept.py.
static inline void around(Job j, int x, int y, int64_t at[5]) {
    int64_t own = (int64_t)y * j.W + x;
    at[0] = own, at[1] = y ? own - j.W : own, at[2] = x ? own - 1 : own;
    at[3] = x + 1 < j.W ? own + 1 : own, at[4] = y + 1 < j.H ? own + j.W : own;
}

// The motion of the front in the first pixel beside (x, y) that saw it in a kept frame; off the screen where none did.
static inline void front_beside(Job j, const uint32_t *kept, int x, int y, float nearest, float between, float motion[2]) {
    int64_t at[5];
    around(j, x, y, at);
    motion[0] = motion[1] = FAR_AWAY;
    for (int i = 4; i > 0; i--) {
        const uint32_t *w = kept + at[i] * WORDS;
        float away = distance(high(w[1]));
        if (away >= nearest && away < between) motion[0] = low(w[4]), motion[1] = high(w[4]);
    }
}

// Whether distances around the pixels of row y differ enough for an edge; `found` has a value for each of them.
static inline void search(Job j, int y, uint8_t *found) {
    const float *own = j.depth + (int64_t)y * j.W, *above = y ? own - j.W : own, *below = y + 1 < j.H ? own + j.W : own;
#pragma omp simd
    for (int x = 0; x < j.W; x++) {
        float beside[4] = {above[x], own[MAX(x - 1, 0)], own[MIN(x + 1, j.W - 1)], below[x]};
        float near = distance(own[x]), far = near;
        for (int i = 0; i < 4; i++) {
            near = MIN(near, distance(beside[i]));
            far = MAX(far, distance(beside[i]));
        }
        found[x] = near < (1 - j.apart) * far;
    }
}

static inline void compose(Job j, int x, int y) {
    int64_t at[5], own = (int64_t)y * j.W + x, plane = j.plane;
    around(j, x, y, at);
    int64_t front = own, behind = own;
    float near = distance(j.depth[own]), far = near;
    for (int i = 1; i < 5; i++) {
        float other = distance(j.depth[at[i]]);
        if (other < (1 - j.apart) * near) front = at[i], near = other;
        if ((1 - j.apart) * other > far) behind = at[i], far = other;
    }
    float mx = j.motion[front], my = j.motion[plane + front];
    float dx = mx - j.motion[behind], dy = my - j.motion[plane + behind];
    if (!(near < (1 - j.apart) * far) || !(dx * dx + dy * dy > j.speed * j.speed)) return;

    float between = isinf(far) ? 2 * near : sqrtf(near) * sqrtf(far), back[SEEN], sum[SEEN], weights = 1, fronts = 0, left = 1;
    int now_front = distance(j.depth[own]) < between;
    for (int c = 0; c < SEEN; c++) {
        back[c] = j.seen[c * plane + behind];
        sum[c] = now_front ? j.now[c][own] : back[c];
    }
    for (int k = 0; k < j.K; k++) {
        float u = nearbyintf(bounded(mx)) + x, v = nearbyintf(bounded(my)) + y;
        if (!((u >= 0) & (u < j.W) & (v >= 0) & (v < j.H))) break;  // a path ends off the screen
        const uint32_t *w = j.kept[k] + ((int64_t)v * j.W + (int64_t)u) * WORDS;
        float away = distance(high(w[1])), weight = left * covered(mx) * covered(my);
        float nearest = (1 - (float)TOLERANCE) * near, onward[2] = {low(w[4]), high(w[4])};
        if (away < nearest || away >= between) front_beside(j, j.kept[k], u, v, nearest, between, onward);
        if (away < nearest)  // something passed before both
            weight = 0;
        else if (away < between) {  // it was hit, then
            float albedo[3] = {low(w[5]), high(w[5]), low(w[6])}, light[3] = {low(w[0]), high(w[0]), low(w[1])};
            float normal[3] = {low(w[2]), high(w[2]), low(w[3])};
            for (int c = 0; c < 3; c++) {
                sum[c] += weight * light[c] * (albedo[c] + (float)GLOSS);
                sum[3 + c] += weight * albedo[c];
                sum[6 + c] += weight * normal[c];
            }
            fronts += weight;
        } else
            for (int c = 0; c < SEEN; c++) sum[c] += weight * back[c];
        weights += weight;
        left *= 1 - high(w[3]);
        mx += onward[0], my += onward[1];
    }
    for (int c = 0; c < SEEN; c++) {
        int64_t to = c * plane + own;
        float was = j.seen[to], composed = sum[c] / weights;
        if (c < 3 && fabsf(composed - was) <= j.same * was) continue;
        j.out[to] = lerp(was, composed, c < 3 ? j.light : 1);
    }
    j.coverage[own] = now_front, j.coverage[plane + own] = fronts, j.coverage[2 * plane + own] = weights - 1;
}

// seen, out [B, 9, H, W], now: B × 9 planes, motion [B, 2, H, W], depth [B, 1, H, W], kept: B × K times [H, W, WORDS]; all
// contiguous. coverage: zeros [B, 3, H, W]. found has W bytes for each of `threads` threads.
void over(const float *seen, const float *const *now, const float *motion, const float *depth, const uint32_t *const *kept,
          float *out, float *coverage, uint8_t *found, int K, int B, int H, int W, float apart, float speed, float light,
          float same, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int t = 0; t < threads; t++)
        for (int64_t row = (int64_t)B * H * t / threads; row < (int64_t)B * H * (t + 1) / threads; row++) {
            int64_t b = row / H, y = row % H;
            Job j = {seen + SEEN * b * plane, motion + 2 * b * plane, depth + b * plane, now + SEEN * b, kept + b * K,
                     out + SEEN * b * plane, coverage + 3 * b * plane, apart, speed, light, same, plane, K, H, W};
            for (int c = 0; c < SEEN; c++) {
                int64_t from = c * plane + y * W;
                memcpy(j.out + from, j.seen + from, W * sizeof *j.out);
            }
            uint8_t *edges = found + (int64_t)t * W;
            search(j, y, edges);
            for (int x = 0; x < W; x++)
                if (edges[x]) compose(j, x, y);
        }
}
