#version 430
// Where light has changed so much that the frames before do not tell of it (ops.outdated), and surfaces do not turn. History gives
// way by the share, and from OUTDATED_PICTURE on the previous output is as if it were off the screen. A work group is a cell of
// OUTDATED_CELL² pixels. The mean of albedo, of n frames and this one, gives way as far as surfaces turn: n (1 - turned) count.
#pragma constants OUTDATED_CELL OUTDATED_PICTURE OUTDATED_RIM TURNED_CELL
#include "image.glsl"
#include "past.glsl"

#pragma reads vec2 most          // [⌈H/OUTDATED_RIM⌉, ⌈W/OUTDATED_RIM⌉] of `agreement`
#pragma reads vec4 noisy         // [H, W] rgb: radiance
#pragma reads vec4 before        // [H, W] rgb, flags: the previous output, reprojected
#pragma reads vec4 running       // [H, W] rgb, n
#pragma reads vec4 guide         // [H, W] rgb: albedo
#pragma changes vec4 mean_albedo // [H, W] rgb, with this frame; whether the surface was there
#pragma writes vec4 past         // [H, W] as `before`, or noisy radiance without ON_SCREEN
#pragma changes float turned     // [⌈H/TURNED_CELL⌉, ⌈W/TURNED_CELL⌉] the share that gives way
#pragma parameters float frames

const int SIDE = OUTDATED_CELL / OUTDATED_RIM, REACH = 5;
shared float whole[REACH * REACH];  // of the cells up to two from this one
shared float sure[9];               // of those beside it

float share_of(vec2 most) { return most.y * max(1.0 - most.x, 0.0); }

float whole_of(ivec2 cell) {
    ivec2 extent = (size + OUTDATED_RIM - 1) / OUTDATED_RIM;
    vec2 greatest = vec2(0.0);
    for (int k = 0; k < SIDE * SIDE; ++k) {
        ivec2 part = SIDE * cell + ivec2(k % SIDE, k / SIDE);
        if (inside(part, extent)) greatest = max(greatest, most[at(part, extent)]);
    }
    return share_of(greatest);
}

float sure_of(ivec2 place) {  // 1 to 3 of REACH, either way
    float around = 0.0, own = whole[at(place, ivec2(REACH))];
    for (int k = 0; k < 9; ++k) around += whole[at(place + ivec2(k % 3, k / 3) - 1, ivec2(REACH))];
    return own * min(around - own, 1.0);
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int lane = int(gl_LocalInvocationIndex), cell = at(pixel / TURNED_CELL, (size + TURNED_CELL - 1) / TURNED_CELL);
    bool has = inside(pixel, size);
    float turn = has ? turned[cell] : 0.0;
    if (lane < REACH * REACH) whole[lane] = whole_of(ivec2(gl_WorkGroupID.xy) + ivec2(lane % REACH, lane / REACH) - REACH / 2);
    barrier();
    if (lane < 9) sure[lane] = sure_of(ivec2(lane % 3, lane / 3) + 1);
    barrier();
    if (!has) return;
    float near = 0.0;
    for (int k = 0; k < 9; ++k) near = max(near, sure[k]);
    vec2 here = most[at(pixel / OUTDATED_RIM, (size + OUTDATED_RIM - 1) / OUTDATED_RIM)];
    float rim = min(near, share_of(vec2(here.x / frames, here.y)));
    float share = (1.0 - turn) * max(whole[REACH * REACH / 2], rim);
    int i = at(pixel, size);
    past[i] = share < OUTDATED_PICTURE ? before[i] : vec4(noisy[i].rgb, float(int(before[i].w) & ~ON_SCREEN));
    float n = mean_albedo[i].w * running[i].w, kept = (1.0 - turn) * (1.0 + n) / (1.0 + (1.0 - turn) * n);
    mean_albedo[i].rgb = mix(guide[i].rgb, mean_albedo[i].rgb, kept);
    if (pixel.x % TURNED_CELL == 0 && pixel.y % TURNED_CELL == 0) turned[cell] = turn + (1.0 - turn) * share;
}
