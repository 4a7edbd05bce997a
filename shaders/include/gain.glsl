// Logarithms of gains of squares of cells, linear between the middles of squares (ops.relit).

// Where cell x lies between the middles of squares of `side` cells, of which there are n: the one before it, the one after, and
// its weight.
float between(int x, int side, int n, out int low, out int high) {
    float place = max((float(x) + 0.5) / float(side) - 0.5, 0.0);
    low = min(int(place), n - 1);
    high = min(low + 1, n - 1);
    return place - float(low);
}

// Defines `vec3 NAME(cell, extent)`: that of a cell, of `extent`, from the GAINS of squares of SIDE × SIDE cells.
#define SPREAD(NAME, GAINS, SIDE) \
    vec3 NAME(ivec2 cell, ivec2 extent) { \
        ivec2 squares = (extent + (SIDE) - 1) / (SIDE), low, high; \
        float u = between(cell.x, SIDE, squares.x, low.x, high.x), v = between(cell.y, SIDE, squares.y, low.y, high.y); \
        vec3 top = mix(GAINS[at(low, squares)].rgb, GAINS[at(ivec2(high.x, low.y), squares)].rgb, u); \
        vec3 bottom = mix(GAINS[at(ivec2(low.x, high.y), squares)].rgb, GAINS[at(high, squares)].rgb, u); \
        return mix(top, bottom, v); \
    }
