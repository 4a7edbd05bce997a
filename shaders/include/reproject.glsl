// The four pixels around the target of a motion vector. A tap has its bilinear weight, or 0 where it is off the screen or
// shows another surface than `here`.
//
// `vec4 surface_before_at(ivec2 pixel)`, normal and depth of the previous frame, is defined before this file is included.
#pragma constants MIN_HISTORY_WEIGHT FAR_AWAY
#include "finite.glsl"
#include "alike.glsl"

struct Taps { ivec2 corner; vec4 weight; float total; };

ivec2 tap_pixel(Taps taps, int tap) {
    return taps.corner + ivec2(tap & 1, tap >> 1);
}

Taps weigh_taps(ivec2 pixel, vec2 motion, vec4 here, float depth_tolerance, float normal_tolerance) {
    motion = vec2(finite_or(motion.x, FAR_AWAY), finite_or(motion.y, FAR_AWAY));
    vec2 target = vec2(pixel) + clamp(motion, -FAR_AWAY, FAR_AWAY);
    Taps taps = Taps(ivec2(floor(target)), vec4(0.0), 0.0);
    vec2 f = target - vec2(taps.corner);
    for (int tap = 0; tap < 4; ++tap) {
        ivec2 p = tap_pixel(taps, tap);
        if (!inside(p, size) || !alike(here, surface_before_at(p), depth_tolerance, normal_tolerance)) continue;
        taps.weight[tap] = ((tap & 1) == 1 ? f.x : 1.0 - f.x) * ((tap >> 1) == 1 ? f.y : 1.0 - f.y);
        taps.total += taps.weight[tap];
    }
    return taps;
}

// Whether the taps make a history: dividing by a smaller sum of weights would only magnify rounding.
bool is_valid(Taps taps) {
    return taps.total >= MIN_HISTORY_WEIGHT;
}
