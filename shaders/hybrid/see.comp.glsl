#version 430
// The footprint of each pixel with this frame in it (models.past.footprint), the trust in history (Kernels.trust of
// models.accumulated_kpn), and how far noise may be evened, as history does not give way (models.past.stays) and nothing shines
// beside (ops.glow). With ALONE it is what this frame shows. RESET of the network's reset counts for footprints.
#pragma constants ALONE RECALL_SAME RESET
#include "image.glsl"
#include "giving_way.glsl"
#include "albedo.glsl"
#include "past.glsl"
#include "glow.glsl"

#pragma reads vec4 light, vec4 guide, vec4 surface  // [H, W]
#pragma reads vec4 past                             // [H, W] rgb, flags
#pragma reads float reset                           // [H, W] as the network said; not read where ALONE
#pragma changes vec4 seen                           // [3, H, W] rgb, frames · albedo, trust · normal, stays

// With this frame in it: what differs by RECALL_SAME or less is the same, as kept frames are bfloat16.
vec3 mean(vec3 before, vec3 now, float weight) {
    return mix(mix(before, now, lessThanEqual(abs(before - now), RECALL_SAME * abs(now))), now, weight);
}

GLOW(glows, guide)

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size), plane = size.x * size.y;
    vec3 rgb = light[i].rgb * divisor(guide[i]), albedo = guide[i].rgb, normal = surface[i].xyz;
    float weight = 1.0, trust = 1.0, stays = 1.0;
    if (ALONE == 0) {
        weight = 1.0 / (1.0 + seen[i].w);
        weight += giving_way(RESET * reset[i], pixel) * (1.0 - weight);
        if (!is_uncovered(past[i])) stays -= giving_way(0.0, pixel);
        if (has_history(past[i])) trust = (1.0 - reset[i]) * 0.5 * (1.0 + stays);
        if (glows(pixel)) stays = 0.0;
        rgb = mean(seen[i].rgb, rgb, weight);
        albedo = mean(seen[i + plane].rgb, albedo, weight);
        normal = mean(seen[i + 2 * plane].xyz, normal, weight);
    }
    seen[i] = vec4(rgb, 1.0 / weight);
    seen[i + plane] = vec4(albedo, trust);
    seen[i + 2 * plane] = vec4(normal, stays);
}
