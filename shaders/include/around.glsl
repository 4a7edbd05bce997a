// What is around a pixel (ops.around): in its cell of AROUND_CELL² pixels and the eight cells around that. A work group reduces
// one cell.
#pragma constants AROUND_CELL
#include "image.glsl"

ivec2 cells_of(ivec2 size) {
    return (size + AROUND_CELL - 1) / AROUND_CELL;
}
