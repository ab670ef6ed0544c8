/* The paper's rack-force estimator over a whole recording, by hand: the peer of batch_estimator.py.

   What eps_hil's default estimator does with sound signals: values read between their neighbours at
   one physical instant, noise learnt from third differences, dead zone, creep by the angle, LuGre
   bristle, limiter (as far as the friction is unknown), observer,
   output filter. It judges nothing: no plausibility, gaps, jumps of
   time, effects or adapted levels. The numbers come from the same model, in the order of the enum. */
#include <math.h>
#include <stdint.h>

enum { STEP, INV_J, RATIO, SENSOR, L0, L1, L2, L3, L4, L5, OBS_LAG, OUT_LAG, LP, ACC_LP, SLOPE_LP,
       DEAD, DEAD_SIGMA, GAIN_W, GAIN_T, ANGLE_LP, LIM_W, LIM_A, K0P, K0N, KWP, KWN, KRP, KRN, S0, S1,
       SW, NOISE_T, NOISE_S, NOISE_W, NOISE_A, NOISE_N, MEMORY, COUNT };

typedef struct { const int64_t *t; const double *v; long n, at, learnt; int64_t delay; double var, of; } Signal;

static void learn(Signal *s, int64_t t, double memory)
{
    while (s->learnt < s->n && s->t[s->learnt] <= t) {
        long k = s->learnt++;
        if (k < 3) continue;
        int64_t p = s->t[k] - s->t[k - 1], u1 = s->t[k - 1] - s->t[k - 2] - p, u2 = s->t[k - 2] - s->t[k - 3] - p;
        if (u1 < 0) u1 = -u1;
        if (u2 < 0) u2 = -u2;
        if (4 * (u1 > u2 ? u1 : u2) > p) continue;
        double bend = s->v[k] - s->v[k - 3] + 3.0 * (s->v[k - 2] - s->v[k - 1]), power = bend * bend / 20.0;
        s->of = fmin(s->of + 1.0, memory / (double)p);
        s->var += (fmin(power, 9.0 * s->var) - s->var) / s->of;
    }
}

static double at(Signal *s, int64_t t)
{
    while (s->at + 2 < s->n && s->t[s->at + 1] <= t) s->at++;
    long k = s->at;
    int64_t t0 = s->t[k], t1 = s->t[k + 1];
    if (t == t0) return s->v[k];
    return s->v[k] + (s->v[k + 1] - s->v[k]) * ((double)(t - t0) / (double)(t1 - t0));
}

static double level_of(const double *c, double w, double load)
{
    double up = c[K0P] + c[KWP] * fabs(w) + c[KRP] * fabs(load), down = c[K0N] + c[KWN] * fabs(w) + c[KRN] * fabs(load);
    return fmax(w >= 0.0 ? up : down, 1e-6);
}

/* Samples (t in ns, v) of torque, sensor, speed, angle; the grid starts at the first speed sample.
   Returns the rows: physical instant, force, friction. Rows before every signal is there are skipped. */
long estimate(const double *c, const int64_t **t, const double **v, const int64_t *n, const int64_t *delay,
              int64_t lookback, int64_t step, int64_t *out_t, double *out_force, double *out_friction)
{
    Signal s[4];
    for (int i = 0; i < 4; i++)
        s[i] = (Signal){t[i], v[i], n[i], 0, 0, delay[i], c[NOISE_T + i], c[NOISE_N]};
    double phi = 0, omega = 0, force = 0, torque_before = 0, slope = 0, once = 0, twice = 0, z = 0, speed = 0, acc = 0;
    double angle = 0, held = 0, unknown = 0, line[640] = {0};
    int head = 0, running = 0;
    long rows = 0;
    int64_t begin = 0, lag = (int64_t)rint(c[OUT_LAG] * 1e9);
    for (int i = 0; i < 4; i++)
        if (t[i][0] - delay[i] > begin) begin = t[i][0] - delay[i];
    int64_t last = t[2][n[2] - 1];
    for (int64_t grid = t[2][0]; grid <= last + step / 2; grid += step) {
        int64_t now = grid - lookback;
        for (int i = 0; i < 4; i++) learn(&s[i], now + s[i].delay, c[MEMORY]);
        if (now < begin) continue;
        double tm = at(&s[0], now + s[0].delay), ts = at(&s[1], now + s[1].delay);
        double w = at(&s[2], now + s[2].delay), a = at(&s[3], now + s[3].delay);
        double var_t = s[0].var + c[SENSOR] * c[SENSOR] * s[1].var, var_w = s[2].var, var_a = s[3].var;
        double torque = tm + c[SENSOR] * ts;
        if (!running) {
            double load = c[RATIO] * torque, end = level_of(c, w, load) / c[S0];
            phi = a, omega = w, speed = w, angle = held = a;
            z = fabs(w) > c[LIM_W] ? copysign(end, w) : 0.0;
            force = once = twice = load - c[RATIO] * c[S0] * z;
            unknown = c[S0] * fabs(z) + fmax(level_of(c, 1.0, load), level_of(c, -1.0, load));
            torque_before = torque - c[S0] * z;
            running = 1;
        }
        double load = force + slope * (c[OBS_LAG] + c[STEP]);
        double sigma = sqrt(c[GAIN_W] * var_w + c[GAIN_T] * var_t);
        int resting = fabs(omega) < fmax(c[DEAD], c[DEAD_SIGMA] * sigma);
        double travel = 0.5 * (w + speed) * c[STEP], slip, from = held;
        if (!resting) angle += travel;
        angle += c[ANGLE_LP] * (a - angle);
        if (resting) {
            double gap = 3.0 * sqrt(c[ANGLE_LP] / (2.0 - c[ANGLE_LP]) * var_a);
            held = fmin(fmax(held, angle - gap), angle + gap);
        } else {
            held = angle;
        }
        travel = held - from, slip = fabs(travel);
        double moving = resting ? 0.0 : w;
        acc += c[ACC_LP] * ((w - speed) / c[STEP] - acc);
        speed = w;
        double way = moving != 0.0 ? moving : travel != 0.0 ? travel : z, level = level_of(c, way, load), before = fabs(z);
        if (unknown >= 1e-6 && slip != 0.0) unknown *= exp(-slip * c[S0] / level);
        double decay = slip * c[S0] / level, lost = -expm1(-decay), share = decay > 1e-9 ? lost / decay : 1.0 - 0.5 * decay;
        z = z * (1.0 - lost) + travel * share;
        if (resting) {
            double limit = fmax(level / c[S0], before);
            z = fmin(fmax(z, -limit), limit);
        }
        double friction = c[S0] * z, ratio = moving / c[SW];
        if (ratio * ratio <= 60.0)
            friction += c[S1] * exp(-ratio * ratio) * (moving - fabs(moving) * c[S0] * z / level);
        if (fabs(w) < c[LIM_W] && fabs(acc) < c[LIM_A])
            friction = copysign(fmin(fabs(friction), fmax(fabs(torque), fabs(friction) - unknown)), friction);
        torque -= friction;
        double mean = 0.5 * (torque + torque_before), bend = c[INV_J] * (mean - force / c[RATIO]);
        torque_before = torque;
        phi += c[STEP] * omega + 0.5 * c[STEP] * c[STEP] * bend;
        omega += c[STEP] * bend;
        double e = w - omega, was = force;
        phi += c[L1] * e, omega += c[L3] * e, force += c[L5] * e;
        slope += c[SLOPE_LP] * ((force - was) / c[STEP] - slope);
        once += c[LP] * (force - once);
        twice += c[LP] * (once - twice);
        line[head] = friction;
        double steps = fmin(c[OUT_LAG] / c[STEP], 638.0);
        int whole = (int)steps;
        double newer = line[(head - whole + 640) % 640], older = line[(head - whole + 639) % 640];
        head = (head + 1) % 640;
        out_t[rows] = now - lag;
        out_force[rows] = twice;
        out_friction[rows++] = newer + (steps - whole) * (older - newer);
    }
    return rows;
}
