// Frames as `accumulated_kpn/keep` and `hybrid/keep` write them, and paths back through them (ops.recall.Path). A path is its
// motion to the kept frame, and the share that resets have left.
#pragma constants FAR_AWAY
#include "bfloat16.glsl"
#include "finite.glsl"

#pragma reads uint kept  // [5 or 8, H, W]

struct KeptPixel { vec3 light; vec4 surface; float reset; vec2 motion; };  // surface: normal, depth

KeptPixel kept_at(ivec2 pixel) {
    int i = at(pixel, size), plane = size.x * size.y;
    vec2 first = unpacked_two(kept[i]), second = unpacked_two(kept[i + plane]), xy = unpacked_two(kept[i + 2 * plane]);
    vec2 last = unpacked_two(kept[i + 3 * plane]);
    return KeptPixel(vec3(first, second.x), vec4(xy, last.x, second.y), last.y, unpacked_two(kept[i + 4 * plane]));
}

// What only `hybrid/keep` writes.
struct KeptEdge { vec3 albedo; vec2 motion; };

KeptEdge kept_edge_at(ivec2 pixel) {
    int i = at(pixel, size), plane = size.x * size.y;
    vec2 third = unpacked_two(kept[i + 6 * plane]), last = unpacked_two(kept[i + 7 * plane]);
    return KeptEdge(vec3(unpacked_two(kept[i + 5 * plane]), third.x), vec2(third.y, last.x));
}

vec2 bounded(vec2 motion) {
    return clamp(vec2(finite_or(motion.x, FAR_AWAY), finite_or(motion.y, FAR_AWAY)), -FAR_AWAY, FAR_AWAY);
}

// The pixel of the kept frame where a bounded motion leads.
ivec2 end_of(ivec2 pixel, vec2 motion) {
    return ivec2(roundEven(motion)) + pixel;
}

// Share of that pixel that the path's pixel covers.
float cover(vec2 motion) {
    vec2 apart = abs(motion - roundEven(motion));
    return (1.0 - apart.x) * (1.0 - apart.y);
}
