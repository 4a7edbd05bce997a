// Single pixels that are too bright. The specification is ops/dim.py; RED, GREEN and BLUE are the weights of luminance. Few pixels
// are above the usual brightness: only these look at those around them.
#include "common.h"

static inline float luminance(const float *rgb, int64_t plane) {
    return (float)RED * rgb[0] + (float)GREEN * rgb[plane] + (float)BLUE * rgb[2 * plane];
}

// radiance, out [B, 3, H, W]; usual [B]
void dim(const float *radiance, const float *usual, float *out, float limit, int B, int H, int W, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int line = 0; line < B * H; line++) {
        int64_t b = line / H, y = line % H, first = 3 * b * plane + y * W;
        for (int c = 0; c < 3; c++) memcpy(out + first + c * plane, radiance + first + c * plane, W * sizeof *out);
        if (!(usual[b] > 0)) continue;
        for (int x = 0; x < W; x++) {
            const float *here = radiance + first + x;
            float own = luminance(here, plane), most = usual[b];
            if (!(own > limit * most)) continue;
            for (int v = -1; v <= 1; v++)
                for (int u = -1; u <= 1; u++)
                    if ((u || v) && y + v >= 0 && y + v < H && x + u >= 0 && x + u < W)
                        most = MAX(most, luminance(here + v * W + u, plane));
            if (!(own > limit * most)) continue;
            for (int c = 0; c < 3; c++) out[first + c * plane + x] *= limit * most / own;
        }
    }
}
