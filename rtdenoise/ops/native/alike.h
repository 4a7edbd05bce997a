// Whether two pixels may show the same surface. The specification is ops/alike.py.

typedef struct { float depth, x, y, z; } Surface;  // depth and normal of a pixel

static inline Surface surface_at(const float *depth, const float *normal, int64_t plane, int at) {
    return (Surface){depth[at], normal[at], normal[plane + at], normal[2 * plane + at]};
}

static inline int alike(Surface a, Surface b, float depth_tolerance, float normal_tolerance) {
    float length = sqrtf((a.x * a.x + a.y * a.y + a.z * a.z) * (b.x * b.x + b.y * b.y + b.z * b.z));
    int near = fabsf(a.depth - b.depth) <= depth_tolerance * MAX(a.depth, b.depth);
    int aligned = a.x * b.x + a.y * b.y + a.z * b.z >= normal_tolerance * length;
    int hit = a.depth > 0, other_hit = b.depth > 0;
    return (hit & other_hit & near & aligned) | (!hit & !other_hit);
}
