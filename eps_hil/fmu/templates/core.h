/* One instance of the model: its numbers, its state, and a step of it. */

enum { GIVEN = 2 * INPUTS, START_SPEED = GIVEN + OUTPUTS, START_ANGLE, START_BRISTLE };

typedef struct {
    double start_s, value, rate;
} Piece;

typedef struct {
    double r[VARIABLES]; /* inputs, outputs, parameters */
    double rate[INPUTS]; /* of the inputs, per second, beside those that are inputs */
    double parameters[TERMS * WIDTH];
    double state[TERMS * STATES];
    double time_s, speed, angle, bristle, rack_speed, rack;
    double row[INPUTS]; /* inputs that act now */
    Piece piece[HISTORY]; /* of the motor torque, where the shaft has it late */
    int pieces, newest;
    int forgot; /* 1: of that torque what the shaft has now, for steps were too short */
    int begun;
} Core;

static void core_reset(Core *c)
{
    int k;
    memset(c, 0, sizeof *c);
    for (k = 0; k < VARIABLES; k++)
        c->r[k] = STARTS[k];
}

/* The first variable that is no number or out of its bounds; -1: all are well. */
static int core_wrong(const Core *c)
{
    int k;
    for (k = 0; k < VARIABLES; k++) {
        if (k >= GIVEN && k < GIVEN + OUTPUTS)
            continue;
        if (!(c->r[k] >= LOWEST[k] && c->r[k] <= HIGHEST[k]) || !isfinite(c->r[k]))
            return k;
    }
    return -1;
}

static void core_remember(Core *c)
{
    Piece *one;
    if (LATE_S <= 0.0)
        return;
    if (c->pieces && c->piece[c->newest].start_s >= c->time_s)
        one = &c->piece[c->newest];
    else {
        c->newest = (c->newest + 1) % HISTORY;
        if (c->pieces == HISTORY
            && c->piece[(c->newest + 1) % HISTORY].start_s > c->time_s - LATE_S)
            c->forgot = 1;
        c->pieces = c->pieces < HISTORY ? c->pieces + 1 : HISTORY;
        one = &c->piece[c->newest];
    }
    one->start_s = c->time_s;
    one->value = c->r[0];
    one->rate = c->rate[0] + c->r[INPUTS];
}

static double core_shaft(const Core *c, double t)
{
    int k, at = c->newest;
    t -= LATE_S;
    for (k = 1; k < c->pieces && c->piece[at].start_s > t; k++)
        at = (at + HISTORY - 1) % HISTORY;
    if (t <= c->piece[at].start_s)
        return c->piece[at].value;
    return c->piece[at].value + c->piece[at].rate * (t - c->piece[at].start_s);
}

/* Inputs that act ahead_s from now. */
static void core_row(const Core *c, double ahead_s, double *row)
{
    int i;
    for (i = 0; i < INPUTS; i++)
        row[i] = c->r[i] + ahead_s * (c->rate[i] + c->r[INPUTS + i]);
    if (LATE_S > 0.0 && c->pieces)
        row[0] = core_shaft(c, c->time_s + ahead_s);
}

static void core_outputs(Core *c)
{
    Drive drive;
    Joint joint;
    Instant u;
    double nothing[INPUTS] = {0.0};
    double rack = JOINED ? c->rack : c->angle;
    set_up(c->r, &drive, &joint, c->parameters, c->state);
    u = simulate_instant(drive, c->time_s, c->speed, c->angle, c->row);
    c->r[GIVEN] = c->speed;
    c->r[GIVEN + 1] = c->angle;
    c->r[GIVEN + 2] = simulate_instant(drive, 0.0, 0.0, rack, nothing).position_m;
    c->r[GIVEN + 3] = simulate_friction_nm(drive, u, simulate_level_nm(drive, u), c->bristle,
                                           c->bristle);
}

/* Inputs that were set anew act from now on. */
static void core_set(Core *c)
{
    core_remember(c);
    core_row(c, 0.0, c->row);
}

static void core_begin(Core *c)
{
    c->time_s = 0.0;
    c->speed = c->r[START_SPEED];
    c->angle = c->r[START_ANGLE];
    c->bristle = c->r[START_BRISTLE];
    c->pieces = c->forgot = 0;
    memset(c->state, 0, sizeof c->state);
    core_set(c);
#if JOINED
    {
        Drive drive;
        Joint joint;
        set_up(c->r, &drive, &joint, c->parameters, c->state);
        c->rack_speed = c->speed;
        c->rack = c->angle + two_masses_rest_twist(joint, drive.sensor_to_rotor * c->row[1]
                                                              - c->row[2] / drive.ratio);
    }
#endif
    c->begun = 1;
    core_outputs(c);
}

/* From start_s (since the start of the run) on by length_s; 0 if the result is no number. */
static int core_step(Core *c, double start_s, double length_s)
{
    Drive drive;
    Joint joint;
    double before[INPUTS], after[INPUTS], row[INPUTS];
    c->time_s = start_s;
    core_set(c);
    core_row(c, 0.0, before);
    core_row(c, length_s, after);
    set_up(c->r, &drive, &joint, c->parameters, c->state);
#if JOINED
    {
        TupleDDDDD end = INTERVAL(drive, joint, start_s, length_s, c->speed, c->angle, c->bristle,
                                  c->rack_speed, c->rack, before, after, row);
        c->rack_speed = end.v3;
        c->rack = end.v4;
#else
    {
        TupleDDD end = INTERVAL(drive, start_s, length_s, c->speed, c->angle, c->bristle, before,
                                after, row);
#endif
        c->speed = end.v0;
        c->angle = end.v1;
        c->bristle = end.v2;
    }
    c->time_s = start_s + length_s;
    memcpy(c->row, after, sizeof after);
    core_outputs(c);
    return isfinite(c->speed) && isfinite(c->angle) && isfinite(c->bristle);
}
