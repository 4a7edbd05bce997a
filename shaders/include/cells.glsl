// Values of cells of CELL² pixels, linear between their middles (shift.displacement.spread).
//
// `vec2 cell_value(ivec2 cell)` is defined before this file is included.
#pragma constants CELL

vec2 spread(ivec2 pixel, ivec2 cells) {
    vec2 place = max((vec2(pixel) + 0.5) / float(CELL) - 0.5, 0.0);
    ivec2 low = ivec2(place), high = min(low + 1, cells - 1);
    vec2 f = place - vec2(low);
    return mix(mix(cell_value(low), cell_value(ivec2(high.x, low.y)), f.x),
               mix(cell_value(ivec2(low.x, high.y)), cell_value(high), f.x), f.y);
}
