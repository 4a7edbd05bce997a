// Values of cells of pixels, or of squares of cells, linear between their middles (shift.displacement.spread).

// Where place x lies between the middles of n cells of `side` places: the cell before it, the one after, and its weight.
float between(int x, int side, int n, out int low, out int high) {
    float place = max((float(x) + 0.5) / float(side) - 0.5, 0.0);
    low = min(int(place), n - 1);
    high = min(low + 1, n - 1);
    return place - float(low);
}

// Defines `vec3 NAME(place, extent)`: the value at a place, of `extent`, from those of its cells of SIDE × SIDE places, VALUES.
#define SPREAD(NAME, VALUES, SIDE) \
    vec3 NAME(ivec2 place, ivec2 extent) { \
        ivec2 cells = (extent + (SIDE) - 1) / (SIDE), low, high; \
        float u = between(place.x, SIDE, cells.x, low.x, high.x), v = between(place.y, SIDE, cells.y, low.y, high.y); \
        vec3 top = mix(VALUES[at(low, cells)].xyz, VALUES[at(ivec2(high.x, low.y), cells)].xyz, u); \
        vec3 bottom = mix(VALUES[at(ivec2(low.x, high.y), cells)].xyz, VALUES[at(high, cells)].xyz, u); \
        return mix(top, bottom, v); \
    }
