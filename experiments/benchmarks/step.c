/* The closed loop PD+FC+LE of `diffdrive.loop.simulate`, one lane after the other, as one would write it by hand in C.

   Equation for equation the step of diffdrive: scale, Kalman observer with the closed-form transition, eq. (20) load
   estimator, PD with feed-forward, plant in substeps that foretell the velocity of the next.
   `tests/experiments/benchmarks/test_bench_steps.py` compares it with the JAX roll-out. The layout of `p` is that of
   `experiments/benchmarks/parameters.py`. */

#include <math.h>

enum {
    MASS, DAMPING_P, DAMPING_N, CONSTANT, SCREW_P, SCREW_N, GUIDE_P, GUIDE_N, PRELOAD, GAP_P, GAP_N, STRIBECK_P,
    STRIBECK_N, VISCOUS_P, VISCOUS_N, S0_P, S0_N, S1_P, S1_N, MACHINE
};
enum {
    RESOLUTION = 2 * MACHINE, KP, KD, FF_MASS, FF_DAMPING_P, FF_DAMPING_N, Q_X, Q_V, Q_Z, R, KW, MIN_SPEED, FLOOR,
    LOAD_AMPLITUDE, PARAMETERS
};

typedef struct { double s0, s1, viscous, level, rate; } bristle;
typedef struct { double moving, holding, per_resistance, stays, drawn; } balance;

static inline double side(const double *p, int name, int ahead) { return p[name + 1 - ahead]; }

static inline bristle bristle_at(const double *p, double v, double z, double load)
{
    int ahead = v >= 0.0;
    double coulomb = side(p, SCREW_P, ahead) + side(p, GUIDE_P, ahead) * (p[PRELOAD] + load);
    bristle b;
    b.s0 = side(p, S0_P, z >= 0.0);
    b.s1 = side(p, S1_P, ahead);
    b.viscous = side(p, VISCOUS_P, ahead);
    b.level = coulomb + side(p, GAP_P, ahead) * exp(-fabs(v) / side(p, STRIBECK_P, ahead));
    b.rate = b.s0 * fabs(v) / b.level;
    return b;
}

static inline double friction_force(bristle b, double v, double z)
{
    return b.s0 * z + b.s1 * (v - b.rate * z) + b.viscous * v;
}

/* A substep whose friction is taken at `slip`: the weights of the balance for the mean velocity, and the bristle's. */
static inline balance balance_at(const double *p, double z, double slip, double load, double h)
{
    bristle b = bristle_at(p, slip, z, load);
    balance found;
    double give = 0.5 * h / p[MASS], g = b.level, q = b.s0 * h * fabs(slip);
    double first = ((q * (1.0 / 24) + g * (1.0 / 6)) * q + 0.5 * g * g) * q + g * g * g;
    double mean_of_mean = g * (((q * (1.0 / 24) + 0.125 * g) * q + (1.0 / 3) * g * g) * q + 0.5 * g * g * g);
    double mean = g * first, end = g * g * g * g, gone = q * first;
    double common_denominator = end + gone, share = 1.0 / common_denominator;
    double resistance = 1.0 + (b.viscous + side(p, DAMPING_P, slip >= 0.0)) * give;
    found.moving = common_denominator;
    found.holding = give * (b.s0 * mean - b.s1 * gone / h);
    found.per_resistance = 1.0 / (resistance * common_denominator + give * (b.s0 * h * mean_of_mean + b.s1 * mean));
    found.stays = end * share;
    found.drawn = h * mean * share;
    return found;
}

static inline double mean_velocity(balance b, double v, double z, double push)
{
    return (b.moving * (v + push) - b.holding * z) * b.per_resistance;
}

static inline void transition(const double *p, bristle b, double v, double T, double ad[3][3], double bd[3])
{
    double mass = p[MASS], drag = b.viscous + side(p, DAMPING_P, v >= 0.0);
    double a = (b.s1 + drag) / mass, bb = (b.s0 - b.s1 * b.rate) / mass;
    double det = (b.s0 + drag * b.rate) / mass, m = 0.5 * (a + b.rate), half = 0.5 * (a - b.rate);
    double q = (half * half - bb) * T * T, c, s;
    if (q > 0.25) {
        double root = sqrt(q), fast = m * T + root, slow_end = exp(-det * T * T / fast), fast_end = exp(-fast);
        c = 0.5 * (slow_end + fast_end);
        s = T * 0.5 * (slow_end - fast_end) / root;
    } else if (q < -0.25) {
        double root = sqrt(-q), end = exp(-m * T);
        c = end * cos(root);
        s = T * end * sin(root) / root;
    } else {
        double end = exp(-m * T), even = 1.0, odd = 1.0;
        for (int n = 6; n > 0; n--) {
            even = 1.0 + q * even / (2 * n * (2 * n - 1));
            odd = 1.0 + q * odd / (2 * n * (2 * n + 1));
        }
        c = end * even;
        s = T * end * odd;
    }
    double int_s = (1.0 - c - m * s) / det, int_c = s + m * int_s;
    double int2_s = (T - int_c - m * int_s) / det, int2_c = int_s + m * int2_s;
    ad[0][0] = 1.0; ad[0][1] = int_c - int_s * half; ad[0][2] = -int_s * bb;
    ad[1][0] = 0.0; ad[1][1] = c - s * half; ad[1][2] = -s * bb;
    ad[2][0] = 0.0; ad[2][1] = s; ad[2][2] = c + s * half;
    bd[0] = (int2_c - int2_s * half) / mass; bd[1] = ad[0][1] / mass; bd[2] = int_s / mass;
}

/* One lane over n samples; costs: RMS and peak of the error, RMS of the load error. `position` may be NULL. */
void roll(const double *p, const double *reference, const double *load, long n, double T, int substeps, double *costs,
          double *position)
{
    const double *machine = p, *model = p + MACHINE, *xr = reference, *vr = reference + n, *ar = reference + 2 * n;
    double h = T / substeps, x = xr[0], v = 0.0, z = 0.0, applied = 0.0, last_error = 0.0;
    double e[3] = {xr[0], 0.0, 0.0}, o[3][3] = {{p[Q_X], 0, 0}, {0, p[Q_V], 0}, {0, 0, p[Q_Z]}}, estimate = 0.0;
    double square = 0.0, peak = 0.0, load_square = 0.0;
    for (long k = 0; k < n; k++) {
        double true_load = p[LOAD_AMPLITUDE] * load[k];
        double measured = p[RESOLUTION] > 0.0 ? p[RESOLUTION] * rint(x / p[RESOLUTION]) : x;

        double ad[3][3], bd[3], moved[3][3], w[3][3], predicted[3], gain[3], updated[3];
        double speed = e[1], force = applied + model[CONSTANT];
        transition(model, bristle_at(model, speed, e[2], estimate), speed, T, ad, bd);
        predicted[0] = e[0] + ad[0][1] * e[1] + ad[0][2] * e[2] + bd[0] * force;
        for (int i = 1; i < 3; i++) predicted[i] = ad[i][1] * e[1] + ad[i][2] * e[2] + bd[i] * force;
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) moved[i][j] = ad[i][0] * o[0][j] + ad[i][1] * o[1][j] + ad[i][2] * o[2][j];
        for (int i = 0; i < 3; i++)
            for (int j = i; j < 3; j++)
                w[i][j] = w[j][i] = moved[i][0] * ad[j][0] + moved[i][1] * ad[j][1] + moved[i][2] * ad[j][2]
                                    + (i == j ? p[Q_X + i] : 0.0);
        double var = w[0][0] + p[R], innovation = measured - predicted[0];
        for (int i = 0; i < 3; i++) {
            gain[i] = w[0][i] / var;
            updated[i] = predicted[i] + gain[i] * innovation;
        }
        for (int i = 0; i < 3; i++)
            for (int j = i; j < 3; j++)
                o[i][j] = o[j][i] = w[i][j] - gain[i] * w[0][j] - gain[j] * w[0][i] + gain[i] * gain[j] * var;
        double prior = friction_force(bristle_at(model, predicted[1], predicted[2], estimate), predicted[1],
                                       predicted[2]);
        double posterior = friction_force(bristle_at(model, updated[1], updated[2], estimate), updated[1], updated[2]);
        if (fabs(speed) > p[MIN_SPEED]) estimate += copysign(1.0, speed) * p[KW] * (posterior - prior);
        estimate = fmax(estimate, p[FLOOR]);
        for (int i = 0; i < 3; i++) e[i] = updated[i];

        double error = xr[k] - measured, change = k ? (error - last_error) / T : 0.0;
        applied = p[KP] * error + p[KD] * change + p[FF_MASS] * ar[k] + side(p, FF_DAMPING_P, vr[k] >= 0.0) * vr[k]
                  + posterior;
        last_error = error;

        double table_error = xr[k] - x;
        square += table_error * table_error;
        peak = fmax(peak, fabs(table_error));
        load_square += (estimate - true_load) * (estimate - true_load);
        if (position) position[k] = x;

        double push = (applied + machine[CONSTANT]) * 0.5 * h / machine[MASS];
        double expected = mean_velocity(balance_at(machine, z, v, true_load, h), v, z, push), slip = expected;
        for (int j = 0; j < substeps; j++) {
            balance b = balance_at(machine, z, slip, true_load, h);
            double mean = mean_velocity(b, v, z, push);
            x += h * mean;
            v = 2.0 * mean - v;
            z = b.stays * z + b.drawn * mean;
            double further = mean_velocity(b, v, z, push);
            slip = further + mean - expected;
            expected = further;
        }
    }
    costs[0] = sqrt(square / n);
    costs[1] = peak;
    costs[2] = sqrt(load_square / n);
}

void sweep(const double *p, long lanes, const double *reference, const double *load, long n, double T, int substeps,
           double *costs)
{
    for (long k = 0; k < lanes; k++) roll(p + k * PARAMETERS, reference, load, n, T, substeps, costs + 3 * k, 0);
}
