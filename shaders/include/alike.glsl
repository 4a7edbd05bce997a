// Whether two pixels, (normal, depth) each, may show the same surface (ops.alike): their depths differ by at most
// `depth_tolerance` of the greater one, and the cosine of their normals, which may have any length, is at least
// `normal_tolerance`. Two misses (depth 0) are alike, a hit and a miss are not.
bool alike(vec4 surface, vec4 other, float depth_tolerance, float normal_tolerance) {
    bool hit = surface.w > 0.0, other_hit = other.w > 0.0;
    if (!hit || !other_hit) return hit == other_hit;
    bool near = abs(surface.w - other.w) <= depth_tolerance * max(surface.w, other.w);
    float lengths = sqrt(dot(surface.xyz, surface.xyz) * dot(other.xyz, other.xyz));
    return near && dot(surface.xyz, other.xyz) >= normal_tolerance * lengths;
}
