// The part of convolve_bytes.c that multiplies tiles: pixels are the rows of one factor, of DEEP bytes of a window each; four
// inputs at a time those of the other one, for TILE outputs.
static int tiles_across(const source *s) { return (s->taps * s->channels + DEEP - 1) / DEEP; }

// The weights as tiles, those of TILE outputs of a phase after each other, `further` bytes apart; NULL where there is no memory.
// What a row of a window lacks to whole tiles has weights of zero.
static int8_t *in_tiles(const source *const *sources, const int8_t *weight, int phases, int quads, int stored, int64_t further) {
    int8_t *all = TILE_ROOM((size_t)phases * (stored / TILE) * further), *to = all;
    for (int phase = 0; all && phase < phases; phase++)
        for (int first = 0; first < stored; first += TILE) {
            const int8_t *from = weight + ((int64_t)phase * quads * stored + first) * 4;
            for (int k = 0; k < 2; k++)
                for (int v = 0; v < sources[k]->taps; v++)
                    for (int q = 0; q < tiles_across(sources[k]) * TILE; q++, to += DEEP)
                        if (q < sources[k]->taps * sources[k]->channels / 4) memcpy(to, from, DEEP), from += stored * 4;
                        else memset(to, 0, DEEP);
        }
    return all;
}

// Add a source's products to the sums of TILE or 2·TILE pixels, in tiles 0 and 2, and 1 and 3 for outputs from TILE on, whose
// weights are `further` bytes away; returns the weights after its own.
static inline const int8_t *
add_tiles(const source *s, const uint8_t *const *rows, const int8_t *weight, int64_t further, int parts, int wide) {
    int64_t stride = (int64_t)s->step * s->channels;
    for (int v = 0; v < s->taps; v++)
        for (int k = 0; k < tiles_across(s); k++, weight += TILE * DEEP) {
            const uint8_t *x = rows[v] + k * DEEP;
            TILE_LOAD(4, x, stride);
            TILE_LOAD(6, weight, DEEP);
            TILE_PRODUCTS(0, 4, 6);
            if (parts > 1) {
                TILE_LOAD(7, weight + further, DEEP);
                TILE_PRODUCTS(1, 4, 7);
            }
            if (!wide) continue;
            TILE_LOAD(5, x + TILE * stride, stride);
            TILE_PRODUCTS(2, 5, 6);
            if (parts > 1) TILE_PRODUCTS(3, 5, 7);
        }
    return weight;
}

// As `convolved`; the weights are tiles.
static void convolved_by_tiles(Row r, int64_t further) {
    int scale = r.below->taps ? 2 : 1, parts = r.many > TILE ? 2 : 1;
    for (int j = 0; j * scale + r.b < r.W; j += 2 * TILE) {
        uint8_t space[3][SPAN * MOST];
        const uint8_t *rows[3];
        int32_t sums[2][2][TILE][TILE];
        int wide = (j + TILE) * scale + r.b < r.W, last = (wide ? 2 * TILE : TILE) - 1;
        const int8_t *w = r.weight;
        TILE_ZERO(0);
        TILE_ZERO(1);
        TILE_ZERO(2);
        TILE_ZERO(3);
        for (int k = scale == 1; k < 2; k++) {
            const source *s = k ? r.beside : r.below;
            int unread = (DEEP - 1) / s->channels + 1;  // pixels after a window that its last tile holds, too
            int top = k ? r.i - 1 : r.i / 2 + r.a - 1, left = k ? j * scale + r.b - 1 : j + r.b - 1;
            window(s, top, left, s->taps, last * s->step + s->taps + unread, rows, space);
            tiles_written(space);
            w = add_tiles(s, rows, w, further, parts, wide);
        }
        TILE_STORE(0, sums[0][0], DEEP);
        TILE_STORE(1, sums[0][1], DEEP);
        TILE_STORE(2, sums[1][0], DEEP);
        TILE_STORE(3, sums[1][1], DEEP);
        number *to = r.out + (int64_t)(j * scale + r.b) * r.outputs;
        for (int p = 0; p <= last && (j + p) * scale + r.b < r.W; p++, to += scale * r.outputs)
            for (int o = 0; o < r.many; o += LANES) {
                vector sum;
                memcpy(&sum, sums[p / TILE][o / TILE][p % TILE] + o % TILE, sizeof sum);
                store(to + o, sum, r.factor + o, r.bias + o, MIN(LANES, r.many - o));
            }
    }
}
