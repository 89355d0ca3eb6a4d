static inline double @P@_sgn(double x) { return (x > 0.0) - (x < 0.0); }

/* Bristles that yield before they slide (Dahl 1968), exact over each step of the way. */
static inline double @P@_bristle(double *m, double q, double way)
{
    const double step = q - m[1], goal = step > 0.0 ? 1.0 : -1.0;
    if (m[0] > 0.0) m[2] = goal + (m[2] - goal) * exp(-fabs(step) / way);
    m[0] = 1.0;
    m[1] = q;
    return m[2];
}

/* What x was a while ago, of the last 128 samples; the oldest where none is so old. */
static inline double @P@_earlier(double *m, double t, double x, double by)
{
    double *when = m + 2, *what = m + 130;
    const int count = m[0] < 128.0 ? (int)m[0] + 1 : 128, now = (int)m[1] % 128;
    int newer = now, older = now;
    when[now] = t;
    what[now] = x;
    m[0] = count;
    m[1] = (now + 1) % 128;
    for (int k = 1; k < count && when[older] > t - by; k++) {
        newer = older;
        older = (older + 127) % 128;
    }
    if (older == newer || when[older] > t - by) return what[older];
    return what[older] + (what[newer] - what[older])
        * ((t - by - when[older]) / (when[newer] - when[older]));
}

/* Place of x among edges; at an edge it belongs above. */
static inline int @P@_level(const double *edges, int count, double x)
{
    int low = 0;
    while (count > 0) {
        const int half = count / 2;
        if (edges[low + half] <= x) {
            low += half + 1;
            count -= half + 1;
        } else {
            count = half;
        }
    }
    return low;
}

static inline void @P@_cross(const double *a, double x, double y, double z, double *out)
{
    const double a0 = a[0], a1 = a[1], a2 = a[2];
    out[0] = a1 * z - a2 * y;
    out[1] = a2 * x - a0 * z;
    out[2] = a0 * y - a1 * x;
}
