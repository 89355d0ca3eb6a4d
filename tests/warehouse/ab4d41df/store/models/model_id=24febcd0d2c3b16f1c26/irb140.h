/* Torque of the arm 'irb140', written by modelgap: one header, C99, no allocation.

   irb140_memory memory;
   irb140_start(&memory);
   irb140_torque(&memory, t, q, qd, qdd, tau);

   t is the time since the session began [s]; q, qd, qdd are [rad, rad/s, rad/s^2] and
   tau is [N m], 6 numbers each, joint 1 first. Give the samples in order: friction
   that remembers its way and delays keep what they need in the memory.

   It has: the rigid body,
     viscous on joint 1,
     viscous on joint 2,
     viscous on joint 3,
     viscous on joint 4,
     viscous on joint 5,
     viscous on joint 6,
     coulomb on joint 1,
     coulomb on joint 2,
     coulomb on joint 3,
     coulomb on joint 4,
     coulomb on joint 5,
     coulomb on joint 6,
     rotor_inertia on joint 1,
     rotor_inertia on joint 2,
     rotor_inertia on joint 3,
     rotor_inertia on joint 4,
     rotor_inertia on joint 5,
     rotor_inertia on joint 6,
     tables on joint 1,
     tables on joint 2.
   It has not: nothing is left out. */
#ifndef IRB140_H
#define IRB140_H

#include <math.h>

enum { irb140_dof = 6 };

typedef struct { double number[1]; } irb140_memory;

static inline void irb140_start(irb140_memory *memory)
{
    for (int i = 0; i < 1; i++) memory->number[i] = 0.0;
}

static const double irb140_place[6][3] = {{0.0, 0.0, 0.0},
    {0.07, 0.0, 0.352},
    {0.0, 0.0, 0.36},
    {0.38, 0.0, 0.0},
    {0.0, 0.0, 0.0},
    {0.0, 0.0, 0.0}};
static const double irb140_axis[6][3] = {{0.0, 0.0, 1.0},
    {0.0, 1.0, 0.0},
    {0.0, 1.0, 0.0},
    {1.0, 0.0, 0.0},
    {0.0, 1.0, 0.0},
    {1.0, 0.0, 0.0}};
static const double irb140_slide[6][3] = {{0.0, 0.0, 0.0},
    {0.0, 0.0, 0.0},
    {0.0, 0.0, 0.0},
    {0.0, 0.0, 0.0},
    {0.0, 0.0, 0.0},
    {0.0, 0.0, 0.0}};
static const double irb140_still[6][9] = {{0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0},
    {0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0},
    {0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0},
    {1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0},
    {0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0},
    {1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}};
static const double irb140_along[6][9] = {{1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0},
    {1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0},
    {1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0},
    {0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0},
    {1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0},
    {0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}};
static const double irb140_across[6][9] = {{0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0},
    {0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0},
    {0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0},
    {0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0},
    {0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0},
    {0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0}};
static const double irb140_flange[3] = {0.065, 0.0, 0.0};
static const double irb140_gravity[3] = {0.0, 0.0, -9.81};
static const double irb140_rigid[6][10] = {{37.19985903643079, 1.0453160389236995, 1.6293538257956652, 9.79844287019587, 3.1998325024681096, -0.04729178123897258, 3.106711907113125, -0.3317388087007954, -0.5032270726482144, 0.6343578340563634},
    {13.333053281212408, -0.10534508871465453, -1.2159054431439038, 2.4857535450842834, 0.91651490918947, -0.04045277649316365, 0.7486681095286115, -0.16852414298095747, 0.27111484846813705, 0.19839117121255376},
    {19.368199307107226, 0.5352466953119697, 0.15182935046491086, -0.08374485097125897, 0.11889648341785772, 0.04899575190535482, 0.29394242231614764, 0.019052671015363058, 0.0040696462814893974, 0.1804202195108677},
    {6.166087845180098, -0.3201476259669741, -0.00915415974127749, -0.001209017255731402, 0.016745610071950055, -0.003740701058569156, 0.027876845971722304, -0.0025669921613856606, 0.006369516238336316, 0.061613368942720875},
    {0.3574078056216608, 0.181489993185196, 0.00018747942045529035, -0.004361334918487894, -0.008441769492409676, 0.00400516601829079, 0.017682410605196743, -0.0007717463699739685, 0.0005220610133530841, 0.008934045060129221},
    {0.2002221078267412, 0.01665645011226923, -0.0013484342263350374, -0.0006615388573913576, 0.0003461987046617834, -0.0009525501281978235, 0.00026222642363406094, 0.0014795348981754646, -0.000561165648921144, 0.0017462828713691216}};

static inline double irb140_sgn(double x) { return (x > 0.0) - (x < 0.0); }

/* Bristles that yield before they slide (Dahl 1968), exact over each step of the way. */
static inline double irb140_bristle(double *m, double q, double way)
{
    const double step = q - m[1], goal = step > 0.0 ? 1.0 : -1.0;
    if (m[0] > 0.0) m[2] = goal + (m[2] - goal) * exp(-fabs(step) / way);
    m[0] = 1.0;
    m[1] = q;
    return m[2];
}

/* What x was a while ago, of the last 128 samples; the oldest where none is so old. */
static inline double irb140_earlier(double *m, double t, double x, double by)
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
static inline int irb140_level(const double *edges, int count, double x)
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

static inline void irb140_cross(const double *a, double x, double y, double z, double *out)
{
    const double a0 = a[0], a1 = a[1], a2 = a[2];
    out[0] = a1 * z - a2 * y;
    out[1] = a2 * x - a0 * z;
    out[2] = a0 * y - a1 * x;
}

/* Recursive Newton-Euler (Luh, Walker and Paul 1980). A body is its mass, mass times
   centre, and inertia about the joint's origin as xx, xy, yy, xz, yz, zz; a force acts
   on the flange in the base frame, 0 for none. */
static inline void irb140_body(
    const double body[][10], const double *gravity, const double *force,
    const double *q, const double *qd, const double *qdd, double *tau)
{
    double turn[6][9], place[6][3], f[6][3], n[6][3], x[3], y[3], z[3];
    double w[3] = {0.0, 0.0, 0.0}, u[3] = {0.0, 0.0, 0.0};
    double a[3] = {-gravity[0], -gravity[1], -gravity[2]};
    double push[3] = {force ? force[0] : 0.0, force ? force[1] : 0.0,
                      force ? force[2] : 0.0};

    for (int i = 0; i < 6; i++) {
        const double *axis = irb140_axis[i], *slide = irb140_slide[i], *b = body[i], *h = b + 1;
        const double c = cos(q[i]), s = sin(q[i]);
        double *R = turn[i];
        for (int k = 0; k < 9; k++)
            R[k] = irb140_still[i][k] + c * irb140_along[i][k] + s * irb140_across[i][k];
        double *p = place[i];
        for (int k = 0; k < 3; k++)
            p[k] = irb140_place[i][k] + q[i] * (R[3 * k] * slide[0]
                + R[3 * k + 1] * slide[1] + R[3 * k + 2] * slide[2]);

        /* How the origin of the joint moves, then all of it in the joint's frame. */
        irb140_cross(w, p[0], p[1], p[2], x);
        irb140_cross(w, x[0], x[1], x[2], y);
        irb140_cross(u, p[0], p[1], p[2], z);
        for (int k = 0; k < 3; k++) z[k] += a[k] + y[k];
        for (int k = 0; k < 3; k++) {
            a[k] = R[k] * z[0] + R[3 + k] * z[1] + R[6 + k] * z[2];
            x[k] = R[k] * w[0] + R[3 + k] * w[1] + R[6 + k] * w[2];
            y[k] = R[k] * u[0] + R[3 + k] * u[1] + R[6 + k] * u[2];
        }
        irb140_cross(x, axis[0], axis[1], axis[2], z);
        for (int k = 0; k < 3; k++) {
            w[k] = x[k] + axis[k] * qd[i];
            u[k] = y[k] + axis[k] * qdd[i] + z[k] * qd[i];
        }
        irb140_cross(x, slide[0], slide[1], slide[2], z);
        for (int k = 0; k < 3; k++) a[k] += slide[k] * qdd[i] + 2.0 * z[k] * qd[i];
        for (int k = 0; k < 3; k++)
            x[k] = R[k] * push[0] + R[3 + k] * push[1] + R[6 + k] * push[2];
        for (int k = 0; k < 3; k++) push[k] = x[k];

        /* What moves the body so. */
        irb140_cross(w, h[0], h[1], h[2], x);
        irb140_cross(w, x[0], x[1], x[2], y);
        irb140_cross(u, h[0], h[1], h[2], z);
        for (int k = 0; k < 3; k++) f[i][k] = b[0] * a[k] + y[k] + z[k];
        x[0] = b[4] * w[0] + b[5] * w[1] + b[7] * w[2];
        x[1] = b[5] * w[0] + b[6] * w[1] + b[8] * w[2];
        x[2] = b[7] * w[0] + b[8] * w[1] + b[9] * w[2];
        irb140_cross(w, x[0], x[1], x[2], y);
        irb140_cross(a, h[0], h[1], h[2], z);
        n[i][0] = b[4] * u[0] + b[5] * u[1] + b[7] * u[2] + y[0] - z[0];
        n[i][1] = b[5] * u[0] + b[6] * u[1] + b[8] * u[2] + y[1] - z[1];
        n[i][2] = b[7] * u[0] + b[8] * u[1] + b[9] * u[2] + y[2] - z[2];
    }

    const double *end = irb140_flange;
    irb140_cross(push, end[0], end[1], end[2], x);
    for (int k = 0; k < 3; k++) {
        f[6 - 1][k] -= push[k];
        n[6 - 1][k] += x[k];
    }
    for (int i = 6 - 1; i >= 0; i--) {
        const double *axis = irb140_axis[i], *slide = irb140_slide[i];
        const double *R = turn[i], *p = place[i];
        tau[i] = axis[0] * n[i][0] + axis[1] * n[i][1] + axis[2] * n[i][2]
            + slide[0] * f[i][0] + slide[1] * f[i][1] + slide[2] * f[i][2];
        if (i == 0) break;
        for (int k = 0; k < 3; k++) {
            const double *r = R + 3 * k;
            x[k] = r[0] * f[i][0] + r[1] * f[i][1] + r[2] * f[i][2];
            y[k] = r[0] * n[i][0] + r[1] * n[i][1] + r[2] * n[i][2];
        }
        irb140_cross(x, p[0], p[1], p[2], z);
        for (int k = 0; k < 3; k++) {
            f[i - 1][k] += x[k];
            n[i - 1][k] += y[k] - z[k];
        }
    }
}

static inline void irb140_torque(
    irb140_memory *memory, double t, const double *angle,
    const double *speed, const double *acceleration, double *out)
{
    double rigid_[6], sign_[6], total[6], part[6];
    (void)memory, (void)t, (void)part;
    irb140_body(irb140_rigid, irb140_gravity, 0, angle, speed, acceleration, rigid_);
    for (int i = 0; i < 6; i++) total[i] = rigid_[i];
    sign_[0] = tanh(speed[0] / 0.005039341058417287);
    sign_[1] = irb140_sgn(speed[1]);
    sign_[2] = irb140_sgn(speed[2]);
    if (fabs(speed[2]) < 0.13870792838922297) sign_[2] *= 0.98;
    sign_[3] = tanh(speed[3] / 0.018330087686945606);
    if (fabs(speed[3]) < 0.07332035074778243) sign_[3] *= 0.49;
    sign_[4] = tanh(speed[4] / 0.01824381785115286);
    sign_[5] = tanh(speed[5] / 0.02764665144265481);
    { /* viscous on joint 1 */
        static const double a[] = {8.15773272476056};
        const double qd = speed[0];
        total[0] += a[0] * qd;
    }
    { /* viscous on joint 2 */
        static const double a[] = {8.1204039952407};
        const double qd = speed[1];
        total[1] += a[0] * qd;
    }
    { /* viscous on joint 3 */
        static const double a[] = {5.084632305904257};
        const double qd = speed[2];
        total[2] += a[0] * qd;
    }
    { /* viscous on joint 4 */
        static const double a[] = {0.9862921229084759};
        const double qd = speed[3];
        total[3] += a[0] * qd;
    }
    { /* viscous on joint 5 */
        static const double a[] = {1.0051253731001975};
        const double qd = speed[4];
        total[4] += a[0] * qd;
    }
    { /* viscous on joint 6 */
        static const double a[] = {0.5026904361931949};
        const double qd = speed[5];
        total[5] += a[0] * qd;
    }
    { /* coulomb on joint 1 */
        static const double a[] = {12.318454043708218};
        const double sign = sign_[0];
        total[0] += a[0] * sign;
    }
    { /* coulomb on joint 2 */
        static const double a[] = {11.995922962696865};
        const double sign = sign_[1];
        total[1] += a[0] * sign;
    }
    { /* coulomb on joint 3 */
        static const double a[] = {8.094143015488918};
        const double sign = sign_[2];
        total[2] += a[0] * sign;
    }
    { /* coulomb on joint 4 */
        static const double a[] = {2.9624308825097527};
        const double sign = sign_[3];
        total[3] += a[0] * sign;
    }
    { /* coulomb on joint 5 */
        static const double a[] = {3.0198925805688326};
        const double sign = sign_[4];
        total[4] += a[0] * sign;
    }
    { /* coulomb on joint 6 */
        static const double a[] = {1.4870882992349053};
        const double sign = sign_[5];
        total[5] += a[0] * sign;
    }
    { /* rotor_inertia on joint 1 */
        static const double a[] = {3.400009990335909};
        const double qdd = acceleration[0];
        total[0] += a[0] * qdd;
    }
    { /* rotor_inertia on joint 2 */
        static const double a[] = {3.400000333712437};
        const double qdd = acceleration[1];
        total[1] += a[0] * qdd;
    }
    { /* rotor_inertia on joint 3 */
        static const double a[] = {1.1705723649477968};
        const double qdd = acceleration[2];
        total[2] += a[0] * qdd;
    }
    { /* rotor_inertia on joint 4 */
        static const double a[] = {0.12786694607009372};
        const double qdd = acceleration[3];
        total[3] += a[0] * qdd;
    }
    { /* rotor_inertia on joint 5 */
        static const double a[] = {0.1274123669079139};
        const double qdd = acceleration[4];
        total[4] += a[0] * qdd;
    }
    { /* rotor_inertia on joint 6 */
        static const double a[] = {0.05376561184619218};
        const double qdd = acceleration[5];
        total[5] += a[0] * qdd;
    }
    for (int i = 0; i < 6; i++) out[i] = total[i];
    { /* tables on joint 1 */
        double y = 0.049388812944465135;
        y += -0.007283554131441859 * (angle[0]);
        y += -0.007885178221730536 * (angle[1]);
        y += 0.004980562904995708 * (speed[0]);
        y += -0.008432317319048777 * (speed[1]);
        y += -0.011479967525386804 * (acceleration[0]);
        y += 0.007808502781196285 * (acceleration[1]);
        out[0] += y;
    }
    { /* tables on joint 2 */
        double y = -0.2530683622610657;
        out[1] += y;
    }
}

#endif
