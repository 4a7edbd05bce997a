// Windows of pictures of `value`s, for convolutions. SPAN: the pixels of a row that a block reads at most; a picture has MOST
// channels at most.

// A picture that a convolution reads: [height, width, channels], through windows of taps × taps pixels. Neighbouring
// outputs of a block read windows that are `step` pixels apart.
typedef struct {
    const value *pixels;
    int height, width, channels, taps, step;
} source;

// `rows[v]`: `pixels` from column `left` of row `top + v`, for `high` rows; zeros where there are none, for which `space` is used.
static inline void
window(const source *s, int top, int left, int high, int pixels, const value **rows, value (*space)[SPAN * MOST]) {
    int from = MAX(left, 0), to = MIN(left + pixels, s->width), C = s->channels;
    for (int v = 0; v < high; v++) {
        int y = top + v, inside = y >= 0 && y < s->height;
        const value *row = inside ? s->pixels + ((int64_t)y * s->width + from) * C : NULL;
        rows[v] = row;
        if (inside && from == left && to == left + pixels) continue;
        rows[v] = memset(space[v], 0, (size_t)pixels * C * sizeof *row);
        if (inside && from < to) memcpy(space[v] + (from - left) * C, row, (size_t)(to - from) * C * sizeof *row);
    }
}
