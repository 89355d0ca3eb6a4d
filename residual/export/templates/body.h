/* Recursive Newton-Euler (Luh, Walker and Paul 1980). A body is its mass, mass times
   centre, and inertia about the joint's origin as xx, xy, yy, xz, yz, zz; a force acts
   on the flange in the base frame, 0 for none. */
static inline void @P@_@BODY@(
    const double body[][10], const double *gravity, const double *force,
    const @REAL@ *q, const @REAL@ *qd, const @REAL@ *qdd, @REAL@ *tau)
{
    @REAL@ turn[@DOF@][9], place[@DOF@][3], f[@DOF@][3], n[@DOF@][3], x[3], y[3], z[3];
    @REAL@ w[3] = {0.0, 0.0, 0.0}, u[3] = {0.0, 0.0, 0.0};
    @REAL@ a[3] = {-gravity[0], -gravity[1], -gravity[2]};
    @REAL@ push[3] = {force ? force[0] : 0.0, force ? force[1] : 0.0,
                      force ? force[2] : 0.0};

    for (int i = 0; i < @DOF@; i++) {
        const double *axis = @P@_axis[i], *slide = @P@_slide[i], *b = body[i], *h = b + 1;
        const @REAL@ c = @COS@(q[i]), s = @SIN@(q[i]);
        @REAL@ *R = turn[i];
        for (int k = 0; k < 9; k++)
            R[k] = @P@_still[i][k] + c * @P@_along[i][k] + s * @P@_across[i][k];
        @REAL@ *p = place[i];
        for (int k = 0; k < 3; k++)
            p[k] = @P@_place[i][k] + q[i] * (R[3 * k] * slide[0]
                + R[3 * k + 1] * slide[1] + R[3 * k + 2] * slide[2]);

        /* How the origin of the joint moves, then all of it in the joint's frame. */
        @CROSS@(w, p[0], p[1], p[2], x);
        @CROSS@(w, x[0], x[1], x[2], y);
        @CROSS@(u, p[0], p[1], p[2], z);
        for (int k = 0; k < 3; k++) z[k] += a[k] + y[k];
        for (int k = 0; k < 3; k++) {
            a[k] = R[k] * z[0] + R[3 + k] * z[1] + R[6 + k] * z[2];
            x[k] = R[k] * w[0] + R[3 + k] * w[1] + R[6 + k] * w[2];
            y[k] = R[k] * u[0] + R[3 + k] * u[1] + R[6 + k] * u[2];
        }
        @CROSS@(x, axis[0], axis[1], axis[2], z);
        for (int k = 0; k < 3; k++) {
            w[k] = x[k] + axis[k] * qd[i];
            u[k] = y[k] + axis[k] * qdd[i] + z[k] * qd[i];
        }
        @CROSS@(x, slide[0], slide[1], slide[2], z);
        for (int k = 0; k < 3; k++) a[k] += slide[k] * qdd[i] + 2.0 * z[k] * qd[i];
        for (int k = 0; k < 3; k++)
            x[k] = R[k] * push[0] + R[3 + k] * push[1] + R[6 + k] * push[2];
        for (int k = 0; k < 3; k++) push[k] = x[k];

        /* What moves the body so. */
        @CROSS@(w, h[0], h[1], h[2], x);
        @CROSS@(w, x[0], x[1], x[2], y);
        @CROSS@(u, h[0], h[1], h[2], z);
        for (int k = 0; k < 3; k++) f[i][k] = b[0] * a[k] + y[k] + z[k];
        x[0] = b[4] * w[0] + b[5] * w[1] + b[7] * w[2];
        x[1] = b[5] * w[0] + b[6] * w[1] + b[8] * w[2];
        x[2] = b[7] * w[0] + b[8] * w[1] + b[9] * w[2];
        @CROSS@(w, x[0], x[1], x[2], y);
        @CROSS@(a, h[0], h[1], h[2], z);
        n[i][0] = b[4] * u[0] + b[5] * u[1] + b[7] * u[2] + y[0] - z[0];
        n[i][1] = b[5] * u[0] + b[6] * u[1] + b[8] * u[2] + y[1] - z[1];
        n[i][2] = b[7] * u[0] + b[8] * u[1] + b[9] * u[2] + y[2] - z[2];
    }

    const double *end = @P@_flange;
    @CROSS@(push, end[0], end[1], end[2], x);
    for (int k = 0; k < 3; k++) {
        f[@DOF@ - 1][k] -= push[k];
        n[@DOF@ - 1][k] += x[k];
    }
    for (int i = @DOF@ - 1; i >= 0; i--) {
        const double *axis = @P@_axis[i], *slide = @P@_slide[i];
        const @REAL@ *R = turn[i], *p = place[i];
        tau[i] = axis[0] * n[i][0] + axis[1] * n[i][1] + axis[2] * n[i][2]
            + slide[0] * f[i][0] + slide[1] * f[i][1] + slide[2] * f[i][2];
        if (i == 0) break;
        for (int k = 0; k < 3; k++) {
            const @REAL@ *r = R + 3 * k;
            x[k] = r[0] * f[i][0] + r[1] * f[i][1] + r[2] * f[i][2];
            y[k] = r[0] * n[i][0] + r[1] * n[i][1] + r[2] * n[i][2];
        }
        @CROSS@(x, p[0], p[1], p[2], z);
        for (int k = 0; k < 3; k++) {
            f[i - 1][k] += x[k];
            n[i - 1][k] += y[k] - z[k];
        }
    }
}
