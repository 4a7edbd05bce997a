// The motion of the edge in a pixel, and the distance of the surface that has it (ops.recall.edge_motion): those of the nearest
// of the pixel and the four beside it, unless that moves against the pixel by more than RECALL_EDGE_SPEED.
//
// `vec4 surface`, normal and depth, and `vec2 motion_at(ivec2 pixel)` are defined before this file is included.
#pragma constants DEPTH_TOLERANCE RECALL_EDGE_SPEED
#include "beside.glsl"

vec3 edge_motion(ivec2 pixel) {
    vec2 own = motion_at(pixel);
    vec3 edge = vec3(own, distance_of(surface[at(pixel, size)].w)), found = edge;
    for (int k = 1; k < 5; ++k) {
        ivec2 p = beside(pixel, k);
        float other = distance_of(surface[at(p, size)].w);
        if (other < (1.0 - DEPTH_TOLERANCE) * found.z) found = vec3(motion_at(p), other);
    }
    vec2 apart = found.xy - own;
    return dot(apart, apart) <= RECALL_EDGE_SPEED * RECALL_EDGE_SPEED ? found : edge;
}
