#version 430
// Every `step`-th pixel of a frame, and what the previous one shows where it comes from, in a picture of such pixels: for how far
// the camera has gone ahead (history.advance).
#pragma constants MIN_NORMAL_COSINE
#include "image.glsl"
#include "on_screen.glsl"
#include "alike.glsl"

#pragma reads vec4 vectors, vec4 surface, vec4 surface_before  // [H, W]
#pragma writes vec4 places  // [⌈H/step⌉, ⌈W/step⌉] depth now, before; whether normals are alike, and it was on the screen
#pragma parameters ivec2 image_size, int step

void main() {
    ivec2 place = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(place, size)) return;

    int i = at(step * place, image_size);
    vec2 target = vec2(place) + vectors[i].xy / float(step);
    vec4 now = surface[i], before = surface_before[at(step * nearest(target), image_size)];
    bool facing = alike(vec4(now.xyz, 1.0), vec4(before.xyz, 1.0), 0.0, MIN_NORMAL_COSINE);
    places[at(place, size)] = vec4(now.w, before.w, facing ? 1.0 : 0.0, on_screen(target) ? 1.0 : 0.0);
}
