// Registers of TILE rows of DEEP bytes (AMX), in which one instruction multiplies matrices: bytes in groups of four, or bfloat16
// in pairs, whose products are summed to int32 or float32. EMULATED does the same with memory, for tests on other CPUs.
#define TILE 16
#define DEEP 64

#if EMULATED
typedef union {
    uint8_t u[TILE][DEEP];
    int8_t s[TILE][DEEP];
    uint16_t half[TILE][DEEP / 2];
    int32_t whole[TILE][TILE];
    float number[TILE][TILE];
} Tile;
static _Thread_local Tile tile[8];
#define TILE_ROOM malloc  // Windows has no other
#define TILE_ZERO(t) memset(tile + t, 0, sizeof *tile)
#define TILE_LOAD(t, from, stride) \
    for (int row = 0; row < TILE; row++) memcpy(tile[t].u[row], (const uint8_t *)(from) + row * (int64_t)(stride), DEEP)
#define TILE_STORE(t, to, stride) \
    for (int row = 0; row < TILE; row++) memcpy((uint8_t *)(to) + row * (int64_t)(stride), tile[t].u[row], DEEP)
#define TILE_PRODUCTS(t, x, w) tile_products(tile + (t), tile + (x), tile + (w))
#define TILE_HALF_PRODUCTS(t, x, w) tile_half_products(tile + (t), tile + (x), tile + (w))
static inline void tile_products(Tile *sums, const Tile *x, const Tile *w) {
    for (int p = 0; p < TILE; p++)
        for (int o = 0; o < TILE; o++)
            for (int c = 0; c < DEEP; c++) sums->whole[p][o] += x->u[p][c] * w->s[c / 4][o * 4 + c % 4];
}
static inline float half_of(uint16_t bits) { return from_bits((uint32_t)bits << 16); }
static inline void tile_half_products(Tile *sums, const Tile *x, const Tile *w) {
    for (int p = 0; p < TILE; p++)
        for (int o = 0; o < TILE; o++)
            for (int c = 0; c < DEEP / 2; c++)
                sums->number[p][o] += half_of(x->half[p][c]) * half_of(w->half[c / 2][o * 2 + c % 2]);
}
static int tiles_allowed(void) { return 1; }
static void tiles_written(const void *memory) { (void)memory; }
static void tiles_begin(void) {}
static void tiles_end(void) {}
#else
#include <immintrin.h>
#include <sys/syscall.h>
#include <unistd.h>
#define TILE_ROOM(bytes) aligned_alloc(DEEP, bytes)
#define TILE_ZERO _tile_zero
#define TILE_LOAD _tile_loadd
#define TILE_STORE _tile_stored
#define TILE_PRODUCTS _tile_dpbusd  // the first factor unsigned, the second signed
#define TILE_HALF_PRODUCTS _tile_dpbf16ps

// Linux gives a process the registers when it asks.
static int tiles_allowed(void) {
    enum { ARCH_REQ_XCOMP_PERM = 0x1023, XFEATURE_XTILEDATA = 18 };
    return !syscall(SYS_arch_prctl, ARCH_REQ_XCOMP_PERM, XFEATURE_XTILEDATA);
}

// What was written to memory is there when tiles are loaded from it: GCC's instructions do not say that they read any, and the
// one for the shape says that it reads 8 bytes.
static inline void tiles_written(const void *memory) { __asm__ volatile("" : : "r"(memory) : "memory"); }

// Each thread says what shape its registers have, and gives them back.
static void tiles_begin(void) {
    struct { uint8_t palette, start, unused[14]; uint16_t bytes[16]; uint8_t rows[16]; } shape = {.palette = 1};
    for (int t = 0; t < 8; t++) shape.bytes[t] = DEEP, shape.rows[t] = TILE;
    tiles_written(&shape);
    _tile_loadconfig(&shape);
}
static void tiles_end(void) { _tile_release(); }
#endif
