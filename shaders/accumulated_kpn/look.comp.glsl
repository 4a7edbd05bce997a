#version 430
// Look a kept frame up at the end of each pixel's path (ops.recall), and compare its light with this frame's: sums over cells
// of RECALL_CELL² pixels, for `add`. A work group is a row of whole cells. The path goes on by the motion found there.
#pragma constants FIRST RECALL_CELL FAR_AWAY DEPTH_TOLERANCE MIN_NORMAL_COSINE
#include "image.glsl"
#include "alike.glsl"
#include "bfloat16.glsl"
#include "finite.glsl"

#pragma reads vec4 light, vec4 surface  // [H, W] rgb; normal, depth
#pragma reads vec4 chosen               // [H, W] motion to the frame before, where the paths begin
#pragma reads uint kept                 // [5, H, W] as `keep` writes it
#pragma changes vec4 path               // [H, W] motion to the kept frame, share that resets left; not read by the FIRST
#pragma writes vec4 found               // [H, W] its rgb, this share, or 0 where it shows another surface
#pragma writes vec4 cells               // [⌈H/RECALL_CELL⌉, ⌈W/RECALL_CELL⌉] Σ d, Σ |d|²

shared vec4 terms[GROUP_X * GROUP_Y];

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), lane = ivec2(gl_LocalInvocationID.xy);
    vec4 term = vec4(0.0);
    if (inside(pixel, size)) {
        int i = at(pixel, size), plane = size.x * size.y;
        vec3 come = FIRST == 1 ? vec3(chosen[i].xy, 1.0) : path[i].xyz;
        vec2 motion = come.xy;
        motion = clamp(vec2(finite_or(motion.x, FAR_AWAY), finite_or(motion.y, FAR_AWAY)), -FAR_AWAY, FAR_AWAY);
        ivec2 target = ivec2(roundEven(motion)) + pixel;
        vec3 rgb = vec3(0.0);
        float same = 0.0;
        vec2 beyond = vec2(FAR_AWAY), third = vec2(0.0);
        if (inside(target, size)) {
            int there = at(target, size);
            vec2 two = unpacked_two(kept[there + plane]), xy = unpacked_two(kept[there + 2 * plane]);
            rgb = vec3(unpacked_two(kept[there]), two.x);
            third = unpacked_two(kept[there + 3 * plane]);
            same = alike(surface[i], vec4(xy, third.x, two.y), DEPTH_TOLERANCE, MIN_NORMAL_COSINE) ? 1.0 : 0.0;
            beyond = motion + unpacked_two(kept[there + 4 * plane]);
        }
        path[i] = vec4(beyond, come.z * (1.0 - third.y), 0.0);
        found[i] = vec4(rgb, same * come.z);
        vec3 d = same * (sqrt(max(rgb, 0.0)) - sqrt(max(light[i].rgb, 0.0)));
        term = vec4(d, dot(d, d));
    }
    terms[lane.y * GROUP_X + lane.x] = term;
    barrier();
    if (lane.x % RECALL_CELL != 0 || lane.y % RECALL_CELL != 0 || !inside(pixel, size)) return;
    vec4 sum = vec4(0.0);
    for (int y = 0; y < RECALL_CELL; ++y)
        for (int x = 0; x < RECALL_CELL; ++x) sum += terms[(lane.y + y) * GROUP_X + lane.x + x];
    cells[at(pixel / RECALL_CELL, (size + RECALL_CELL - 1) / RECALL_CELL)] = sum;
}
