// History gives way where surfaces have turned (AccumulatedKPN's Heads.giving_way). Without TURNS nothing has.
#pragma constants TURNS TURNED_CELL
#pragma reads float turned  // [⌈H/TURNED_CELL⌉, ⌈W/TURNED_CELL⌉]

// The weight of the current frame, with that.
float giving_way(float weight, ivec2 pixel) {
    if (TURNS == 0) return weight;
    return weight + (1.0 - weight) * turned[at(pixel / TURNED_CELL, (size + TURNED_CELL - 1) / TURNED_CELL)];
}
