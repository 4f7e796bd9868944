// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

/* Many axes in C: the tick of loop/tick.py for an axis like kim2009, operation by operation as in the Python sources
 * named at each function, over the memory of loop/axis_array.py.
 *
 * bench_axis_array.py compiles this file and compares it with the compiled loop. Functions that such an axis does not
 * use (faults, a quiet hold, creep, damping, shaping, learning, a force sensor, noise, a trajectory) are checked for as
 * in Python, but not implemented: a sample that needs one is counted as foreign.
 */

#include "recursions.c"

#include <stdint.h>

/* ---- signals.py -------------------------------------------------------------------------------------------------- */

enum { SETPOINT, REFERENCE, R_COMMAND, R_VOLTAGE, R_DISPLACEMENT, R_MEASURED, R_ESTIMATED, R_APPLIED, R_SWITCHING };
enum { R_DISTURBANCE = 9, PLANT_VOLTAGE, SATURATED, SEEN, SOURCE_MODE, CONTROLLER_MODE, COMPENSATOR_MODE, PLANT_MODE };
enum { TRIPPED = 17, LATE, SKIPPED, ADAPTATION, ADAPTED_GAIN, FORCE, WAVEFORM_SAMPLE, SCAN_EDGES, TRIGGER };
enum { TRIGGER_POSITION = 26, TRIGGER_DIRECTION, TRIGGER_DELAY, TRIGGER_IN, ROW };
enum { M_RUNNING, M_HOLDING, M_STALE, M_STOPPED, M_TRIPPED, M_FOLLOWING };

/* Indices of the arrays of an axis, in the order of its named tuples. */
enum { P_LIMITS, P_HYSTERESIS, P_DYNAMICS, P_SENSOR, P_CREEP, P_FORCE };
enum { PX_LIMITS = 6, PX_HYSTERESIS, PX_DYNAMICS, PX_SENSOR, PX_CREEP, PX_FORCE };
enum { PW_TRIP = 12, PW_FAULTS, PW_HOLD, PW_FRONT, PW_REAR, PWX_TRIP, PWX_FAULTS, PWX_HOLD, PWX_FRONT, PWX_REAR };
enum { S_APPROACH = 22, S_WAVEFORM, S_RANGE, S_TRAJECTORY, S_SHAPING, S_STEPS };
enum { SX_APPROACH = 28, SX_WAVEFORM, SX_RANGE, SX_TRAJECTORY, SX_SHAPING, SX_STEPS, S_EDGES };
enum { C_FEEDFORWARD = 35, C_CONTROLLER, C_DAMPING, C_HANDOVER, C_RETURN, C_HISTORY, C_LEARNING };
enum { CX_FEEDFORWARD = 42, CX_CONTROLLER, CX_DAMPING, CX_HANDOVER, CX_RETURN, CX_HISTORY, CX_LEARNING };
enum { CW_GUARD = 49, CW_FAULTS, CW_OWN, CWX_GUARD, CWX_FAULTS, CWX_OWN };
enum { K_INVERSE = 55, K_HYSTERESIS, K_LIMITS, K_OUT, K_CREEP, KX_INVERSE, KX_HYSTERESIS, KX_LIMITS, KX_OUT, KX_CREEP };
enum { KW_GUARD = 65, KW_FAULTS, KW_OWN, KWX_GUARD, KWX_FAULTS, KWX_OWN, ARRAYS };

/* ---- loop/faults.py ---------------------------------------------------------------------------------------------- */

enum { FAULT_SAMPLES, FAULT_STAMP };

static inline void begin_sample(double *x)
{
    x[FAULT_STAMP] = x[FAULT_SAMPLES];
    x[FAULT_SAMPLES] += 1.0;
}

/* ---- loop/watch.py ----------------------------------------------------------------------------------------------- */

enum { TIMEOUT, SPIKE, CONFIRM, FROZEN };
enum { GOOD, AGE, G_BEGUN, STAMP, SUSPECTS, SAME, G_LAST, REJECTED };

static inline int finite(double value) { return value - value == 0.0; }

static double accept(const double *p, double *x, double value, double stamp)
{
    int usable = finite(value);
    int stale = x[AGE] >= p[TIMEOUT];
    if (usable && x[G_BEGUN] != 0.0) {
        if (stamp <= x[STAMP] && !stale)
            usable = 0;
        if (p[FROZEN] > 0.0) {
            x[SAME] = value == x[G_LAST] ? x[SAME] + 1.0 : 0.0;
            if (x[SAME] >= p[FROZEN])
                usable = 0;
        }
        if (p[SPIKE] > 0.0 && usable && !stale && fabs(value - x[GOOD]) > p[SPIKE]) {
            x[SUSPECTS] += 1.0;
            if (x[SUSPECTS] < p[CONFIRM])
                usable = 0;
        }
        x[G_LAST] = value;
    }
    if (!usable) {
        x[REJECTED] += 1.0;
        if (x[G_BEGUN] != 0.0)
            x[AGE] += 1.0;
        return NAN;
    }
    x[GOOD] = value;
    x[G_LAST] = value;
    x[AGE] = 0.0;
    x[SUSPECTS] = 0.0;
    x[STAMP] = stamp;
    x[G_BEGUN] = 1.0;
    return value;
}

static inline double receive(const double *p, double *x, const double *faults_p, double *faults, double value,
                             double missing, int64_t *foreign)
{
    begin_sample(faults);
    *foreign += faults_p[0] != 0.0;
    return accept(p, x, missing != 0.0 ? NAN : value, faults[FAULT_STAMP]);
}

static inline double towards(double value, double target, double step)
{
    return value + smaller(larger(target - value, -step), step);
}

enum { SAFE, SAFE_STEP, HOLD_TIMEOUT, KEEP };
enum { HELD, GIVEN, HELD_AGE, HELD_BEGUN, FOLLOWS };

static double hold_voltage(const double *p, double *x, double voltage, double stopped, double least)
{
    double step = p[SAFE_STEP];
    if (finite(voltage)) {
        if (x[HELD_BEGUN] != 0.0 && x[HELD_AGE] < p[HOLD_TIMEOUT])
            step += fabs(voltage - x[GIVEN]);
        x[GIVEN] = voltage;
        x[HELD_AGE] = 0.0;
        x[HELD_BEGUN] = 1.0;
    } else if (x[HELD_BEGUN] != 0.0) {
        x[HELD_AGE] += 1.0;
    }
    double target = x[GIVEN];
    int silent = stopped != 0.0 || x[HELD_AGE] >= p[HOLD_TIMEOUT];
    if (silent) {
        x[FOLLOWS] = 0.0;
        step = p[SAFE_STEP];
        target = p[KEEP] != 0.0 ? larger(p[SAFE], x[HELD]) : p[SAFE];
    }
    if (target < least) {
        step = p[SAFE_STEP];
        x[FOLLOWS] = 0.0;
        target = least;
    }
    if (x[FOLLOWS] != 0.0) {
        x[HELD] = target;
        return target;
    }
    x[HELD] = towards(x[HELD], target, step);
    if (!silent && x[HELD_BEGUN] != 0.0 && x[HELD] == x[GIVEN])
        x[FOLLOWS] = 1.0;
    return x[HELD];
}

/* ---- models/creep.py, models/linear.py and models/sensor.py ------------------------------------------------------ */

static inline double creep(const double *p, double *x, double u, int64_t *foreign)
{
    *foreign += p[1] != 0.0;
    double y = p[0] * u + 0.0;
    x[0] = y;
    return y;
}

static inline double creep_inverse(const double *p, double y) { return (y - 0.0) / p[0]; }

static inline double accumulate(double total, const double *p, long row, const double *x, long first, long n)
{
    for (long j = 0; j < n; j++)
        total += p[row + j] * x[first + j];
    return total;
}

static inline void advance(const double *p, long matrix, long column, double *x, long state, long n, double u)
{
    for (long i = 0; i < n; i++)
        x[state + n + i] = accumulate(p[column + i] * u, p, matrix + i * n, x, state, n);
    for (long i = 0; i < n; i++) {
        double value = x[state + n + i];
        x[state + i] = -1e-290 < value && value < 1e-290 ? 0.0 : value;
    }
}

static inline void dynamics_advance(const double *p, double *x, double u)
{
    long n = (long)p[ORDER];
    x[HELD_INPUT] = u;
    advance(p, MATRICES, MATRICES + n * n, x, STATE, n, u / p[INPUT_SCALE]);
}

static inline double sensor(const double *p, double *x, double displacement, int64_t *foreign)
{
    double y = displacement + p[2];
    *foreign += p[0] > 0.0;
    if (p[1] > 0.0)
        y = floor(y / p[1] + 0.5) * p[1];
    x[8] = y;
    return y;
}

/* ---- references/approach.py and references/generator.py ---------------------------------------------------------- */

enum { QUANTUM, A_STEP, WINDOW1, WINDOW2, WEIGHT, SPLIT, LOW, HIGH };
enum { A_SETPOINT, SLEWED, WHOLE, REST, SUM1_UPPER, SUM1_LOWER, SUM2_UPPER, SUM2_LOWER, INDEX1, INDEX2, ARRIVED };
enum { RINGS = 11 };

static inline double quotient(double a, double m)
{
    double n = floor(a / m), rest = a - n * m;
    if (rest < 0.0)
        n -= 1.0;
    else if (rest >= m)
        n += 1.0;
    return n;
}

static inline double approach(const double *p, double *x, double u)
{
    if (u >= p[LOW] && u <= p[HIGH])
        x[A_SETPOINT] = u;
    double target = floor(x[A_SETPOINT] / p[QUANTUM] + 0.5);
    double increment = smaller(larger(target - x[SLEWED], -p[A_STEP]), p[A_STEP]);
    x[SLEWED] += increment;
    x[ARRIVED] = increment == 0.0 ? x[ARRIVED] + 1.0 : 1.0;
    long n1 = (long)p[WINDOW1], n2 = (long)p[WINDOW2], i1 = (long)x[INDEX1];
    double oldest = x[RINGS + i1];
    x[RINGS + i1] = increment;
    x[INDEX1] = i1 + 1 < n1 ? i1 + 1.0 : 0.0;
    double upper = floor(increment / p[SPLIT]), upper_oldest = floor(oldest / p[SPLIT]);
    x[SUM1_UPPER] += upper - upper_oldest;
    x[SUM1_LOWER] += (increment - upper * p[SPLIT]) - (oldest - upper_oldest * p[SPLIT]);
    long i2 = (long)x[INDEX2], j = RINGS + n1 + i2;
    x[SUM2_UPPER] += x[SUM1_UPPER] - x[j];
    x[SUM2_LOWER] += x[SUM1_LOWER] - x[j + n2];
    x[j] = x[SUM1_UPPER];
    x[j + n2] = x[SUM1_LOWER];
    x[INDEX2] = i2 + 1 < n2 ? i2 + 1.0 : 0.0;
    double weight = p[WEIGHT];
    double n = quotient(x[SUM2_UPPER], weight);
    double lower = (x[SUM2_UPPER] - n * weight) * p[SPLIT] + x[SUM2_LOWER] + x[REST];
    double m = quotient(lower, weight);
    x[REST] = lower - m * weight;
    x[WHOLE] += n * p[SPLIT] + m;
    if (x[ARRIVED] >= p[WINDOW1] + p[WINDOW2] - 1.0 && x[SLEWED] == target)
        return x[A_SETPOINT];
    return (x[WHOLE] + x[REST] / weight) * p[QUANTUM];
}

enum { T_SAMPLE_TIME, SMOOTH };
enum { ACTIVE, PENDING, ELAPSED, LENGTH, SEGMENT, COUNT, POSITION, VELOCITY, ACCELERATION, T_GIVEN, T_TARGET, AFTER };
enum { G_MINIMUM, G_MAXIMUM, FADE_SAMPLES, SMOOTHED };
enum { G_RUNNING, G_OUTPUT, FADE, FADE_COUNT };

static double hold(const double *p, double *x)
{
    x[0] += 1.0;
    return p[0];
}

static inline double reference_step(double *m, const int64_t *at, double setpoint, double (*waveform)(const double *, double *),
                                    int64_t *foreign)
{
    const double *p = m + at[S_RANGE], *following_p = m + at[S_TRAJECTORY], *approach_p = m + at[S_APPROACH];
    double *x = m + at[SX_RANGE], *following = m + at[SX_TRAJECTORY];
    if (x[G_RUNNING] == 0.0)
        return x[G_OUTPUT];
    int is_new = setpoint != following[T_GIVEN] && setpoint != following[T_TARGET];
    is_new = is_new && approach_p[LOW] <= setpoint && setpoint <= approach_p[HIGH];
    following[T_GIVEN] = setpoint;
    *foreign += following[ACTIVE] != 0.0;
    if (is_new)
        following[T_TARGET] = INFINITY;
    double position = approach(approach_p, m + at[SX_APPROACH], following[T_TARGET] < INFINITY ? NAN : setpoint);
    *foreign += m[at[S_SHAPING]] != 0.0;
    double velocity = 0.0, acceleration = 0.0;
    if (following_p[SMOOTH] != 0.0) {
        velocity = (position - following[POSITION]) / following_p[T_SAMPLE_TIME];
        acceleration = (velocity - following[VELOCITY]) / following_p[T_SAMPLE_TIME];
    }
    following[POSITION] = position;
    following[VELOCITY] = velocity;
    following[ACCELERATION] = acceleration;
    double reference = position;
    if (x[G_RUNNING] == 1.0) {
        double added = waveform(m + at[S_WAVEFORM], m + at[SX_WAVEFORM]);
        if (p[SMOOTHED] != 0.0)
            added = approach(m + at[S_STEPS], m + at[SX_STEPS], added);
        reference += added;
    }
    if (x[FADE_COUNT] < p[FADE_SAMPLES]) {
        double s = x[FADE_COUNT] / p[FADE_SAMPLES];
        reference += x[FADE] * (1.0 - s * s * s * (10.0 + s * (6.0 * s - 15.0)));
        x[FADE_COUNT] += 1.0;
    }
    reference = smaller(larger(reference, p[G_MINIMUM]), p[G_MAXIMUM]);
    x[G_OUTPUT] = reference;
    return reference;
}

/* ---- control/feedforward.py and control/controller.py ------------------------------------------------------------ */

enum { PREVIEW, F_ORDER, FIRST, TAPS, PAST, DRIVES, WEIGHTS };
enum { F_COMMAND, F_STARTED, NEXT, F_GIVEN, NEWEST, CALLS, F_RING };

static inline double feedforward(const double *p, double *x, double reference)
{
    long length = (long)p[PREVIEW] + 1 + (long)p[PAST], n = (long)p[F_ORDER], drive = WEIGHTS + length;
    long drives = (long)p[DRIVES], matrix = drive + drives, inputs = matrix + n * n, outputs = inputs + n;
    long rest = outputs + n, state = F_RING + length;
    reference = bounded(reference);
    if (x[F_STARTED] == 0.0) {
        x[F_STARTED] = 1.0;
        for (long i = 0; i < length; i++)
            x[F_RING + i] = reference;
        for (long i = 0; i < n; i++)
            x[state + i] = p[rest + i] * reference;
    }
    long newest = (long)x[NEXT];
    x[NEWEST] = reference;
    x[CALLS] += 1.0;
    x[F_RING + newest] = reference;
    long oldest = newest + 1 == length ? 0 : newest + 1;
    x[NEXT] = (double)oldest;
    long place = oldest + (long)p[FIRST];
    if (place >= length)
        place -= length;
    double ahead = p[drive] * x[F_RING + place];
    long driving = place;
    for (long i = 1; i < drives; i++) {
        driving += 1;
        if (driving == length)
            driving = 0;
        ahead += p[drive + i] * x[F_RING + driving];
    }
    double command = 0.0;
    for (long i = 0; i < (long)p[TAPS]; i++) {
        command += p[WEIGHTS + i] * x[F_RING + place];
        place += 1;
        if (place == length)
            place = 0;
    }
    x[F_COMMAND] = accumulate(command, p, outputs, x, state, n) + x[F_GIVEN];
    advance(p, matrix, inputs, x, state, n, ahead);
    long present = oldest + (long)p[PAST];
    if (present >= length)
        present -= length;
    return x[F_RING + present];
}

enum { BIAS, H_LAST, ARMED, QUICK };

static inline double handover(const double *p, double *x, double u)
{
    if (x[ARMED] != 0.0) {
        int lasting = x[ARMED] == 2.0;
        x[ARMED] = 0.0;
        if (p[0] > 0.0) {
            x[QUICK] = 0.0;
            if (lasting)
                x[QUICK] = x[H_LAST] - u - x[BIAS];
            else
                x[BIAS] = x[H_LAST] - u;
            return x[H_LAST];
        }
        x[BIAS] = 0.0;
    }
    double bias = x[BIAS] * p[0], quick = 0.5 * x[QUICK], y = u + bias;
    if (fabs(bias) < 1e-300 || y == u)
        bias = 0.0;
    if (fabs(quick) < 1e-300 || y + quick == y)
        quick = 0.0;
    y += quick;
    x[BIAS] = bias;
    x[QUICK] = quick;
    x[H_LAST] = y;
    return y;
}

static void note(double *x, double applied, double reference, double fed, double measured)
{
    long place = 1 + 4 * ((long)x[0] % 500);
    x[place] = applied;
    x[place + 1] = reference;
    x[place + 2] = fed;
    x[place + 3] = measured;
    x[0] += 1.0;
}

/* ---- loop/controller.py ------------------------------------------------------------------------------------------ */

enum { SAFE_COMMAND, C_SAFE_STEP, PRELOAD, USE_ORIGIN, PREDICTS, LOWEST, HIGHEST, NEEDS_FORCE };
enum { STOP, RETURNING, ON_PATH, UNANSWERED, ANSWERED, O_REFERENCE, COMMANDED, OFFSET_LEFT, O_FORCE, ACHIEVED };
#define AT_SAFE_VOLTAGE 2.0 /* value of RETURNING */
enum { Q_AHEAD = 10, Q_LEFT, Q_ON_PULSE = 9 }; /* of loop/quiet.py: states, then a parameter */

typedef double (*Law)(const double *, double *, double, double);

static inline double answer(Law law, double *m, const int64_t *at, double value, double wanted)
{
    double *own = m + at[CWX_OWN], *state = m + at[CX_CONTROLLER], *forward = m + at[CX_FEEDFORWARD];
    double *path = m + at[CX_RETURN], *end = m + at[CX_HANDOVER];
    if (own[RETURNING] != 0.0) {
        own[RETURNING] = 0.0;
        own[ON_PATH] = 1.0;
        forward[F_STARTED] = 0.0;
        m[at[CX_HISTORY]] = 0.0;
        m[at[CX_DAMPING]] = 0.0;
        end[H_LAST] = own[COMMANDED];
        end[ARMED] = 1.0;
        path[H_LAST] = value;
        path[ARMED] = 1.0;
        state[STARTED] = 0.0;
    }
    double reference = wanted;
    if (own[ON_PATH] != 0.0) {
        reference = handover(m + at[C_RETURN], path, wanted);
        if (reference == wanted)
            own[ON_PATH] = 0.0;
    }
    double delayed = feedforward(m + at[C_FEEDFORWARD], forward, reference), fed = forward[F_COMMAND];
    double known = value == value ? value : state[ESTIMATED];
    note(m + at[CX_HISTORY], state[APPLIED], delayed, fed, known);
    state[FEEDFORWARD] = fed;
    return handover(m + at[C_HANDOVER], end, law(m + at[C_CONTROLLER], state, delayed, value));
}

static inline void control(Law law, double *m, const int64_t *at, double *row, int64_t *foreign)
{
    const double *own_p = m + at[CW_OWN], *guard_p = m + at[CW_GUARD];
    double *own = m + at[CWX_OWN], *guard = m + at[CWX_GUARD], *state = m + at[CX_CONTROLLER];
    own[O_FORCE] = row[FORCE];
    int unforced = own_p[NEEDS_FORCE] != 0.0 && !finite(own[O_FORCE]);
    double seen = receive(guard_p, guard, m + at[CW_FAULTS], m + at[CWX_FAULTS], row[R_MEASURED],
                          unforced ? 1.0 : row[SKIPPED], foreign);
    double command = own[COMMANDED], value = seen;
    if (finite(row[REFERENCE]))
        own[O_REFERENCE] = row[REFERENCE];
    *foreign += own_p[USE_ORIGIN] != 0.0;
    *foreign += own[Q_AHEAD] != 0.0 || own[Q_LEFT] != 0.0 || own_p[Q_ON_PULSE] != 0.0;
    double offset = own_p[PRELOAD], left = own[OFFSET_LEFT];
    if (left != 0.0) {
        own[OFFSET_LEFT] = fabs(left) > 1e-18 ? left * m[at[C_HANDOVER]] : 0.0;
        offset += left;
    }
    value -= offset;
    double mode = M_RUNNING;
    int answered = 0, unfollowed = own[ANSWERED] != 0.0 && own[UNANSWERED] >= 20.0;
    if (row[TRIPPED] != 0.0)
        mode = M_TRIPPED;
    else if (own[STOP] != 0.0)
        mode = M_STOPPED;
    else if (guard[AGE] >= guard_p[TIMEOUT])
        mode = M_STALE;
    else if (value != value && (unfollowed || unforced
                                || !(own_p[PREDICTS] != 0.0 && own[RETURNING] == 0.0 && state[STARTED] != 0.0)))
        mode = M_HOLDING;
    else if (unfollowed)
        mode = M_FOLLOWING;
    else {
        answered = 1;
        if (value != value)
            mode = M_HOLDING;
    }
    if (answered)
        command = answer(law, m, at, value, own[O_REFERENCE]);
    else if (mode == M_FOLLOWING) {
        command = towards(command, value, own_p[C_SAFE_STEP]);
        own[RETURNING] = 1.0;
    }
    if (mode == M_TRIPPED || mode == M_STOPPED || mode == M_STALE) {
        command = towards(command, own_p[SAFE_COMMAND], own_p[C_SAFE_STEP]);
        if (mode == M_TRIPPED)
            own[RETURNING] = AT_SAFE_VOLTAGE;
        if (own[RETURNING] == AT_SAFE_VOLTAGE && own[ANSWERED] != 0.0)
            command = own[ACHIEVED];
        else
            own[RETURNING] = 1.0;
    }
    own[UNANSWERED] += 1.0;
    *foreign += m[at[C_DAMPING]] != 0.0;
    state[COMMAND] = command;
    double sent = smaller(larger(command, own_p[LOWEST]), own_p[HIGHEST]);
    if (sent != command)
        state[APPLIED] = sent;
    own[COMMANDED] = sent;
    row[R_COMMAND] = sent;
    row[SEEN] = seen;
    row[R_ESTIMATED] = state[ESTIMATED] + offset;
    row[R_SWITCHING] = state[SWITCHING];
    row[R_DISTURBANCE] = state[DISTURBANCE];
    row[CONTROLLER_MODE] = mode;
}

/* ---- models/compensator.py and loop/compensator.py --------------------------------------------------------------- */

enum { K_APPLIED, K_BIAS, K_COMMAND };
enum { SAFE_VOLTAGE, K_SAFE_STEP, TOLERANCE };
enum { K_STOP, K_RETURNING, OWN_COMMAND };

typedef double (*Hysteresis)(const double *, double *, double);
typedef double (*Inverse)(double *, const double *, const double *, double);

static inline double compensator_hold(Hysteresis model, double *m, const int64_t *at, double voltage, int64_t *foreign)
{
    double limited = limits(m + at[K_LIMITS], m + at[KX_LIMITS], voltage);
    double displacement = model(m + at[K_HYSTERESIS], m + at[KX_HYSTERESIS], limited);
    m[at[KX_OUT] + K_APPLIED] = creep(m + at[K_CREEP], m + at[KX_CREEP], displacement, foreign);
    return limited;
}

static inline void compensate(Hysteresis model, Inverse inverse, double *m, const int64_t *at, double *row,
                              int64_t *foreign)
{
    const double *own_p = m + at[KW_OWN], *guard_p = m + at[KW_GUARD];
    double *own = m + at[KWX_OWN], *guard = m + at[KWX_GUARD], *limited = m + at[KX_LIMITS], *out = m + at[KX_OUT];
    double command = receive(guard_p, guard, m + at[KW_FAULTS], m + at[KWX_FAULTS], row[R_COMMAND], 0.0, foreign);
    if (fabs(row[PLANT_VOLTAGE] - limited[OUTPUT]) > own_p[TOLERANCE]) {
        limited[UNQUANTISED] = row[PLANT_VOLTAGE];
        compensator_hold(model, m, at, row[PLANT_VOLTAGE], foreign);
        own[K_RETURNING] = 1.0;
    }
    double mode = M_RUNNING;
    if (row[TRIPPED] != 0.0)
        mode = M_TRIPPED;
    else if (own[K_STOP] != 0.0)
        mode = M_STOPPED;
    else if (guard[AGE] >= guard_p[TIMEOUT])
        mode = M_STALE;
    else if (command != command)
        mode = M_HOLDING;
    else
        own[OWN_COMMAND] = command;
    int skipped = row[SKIPPED] != 0.0;
    if (mode == M_RUNNING && skipped)
        mode = M_HOLDING;
    double voltage;
    if ((mode == M_RUNNING || mode == M_HOLDING) && !skipped) {
        *foreign += own[K_RETURNING] != 0.0;
        double difference = out[K_BIAS];
        out[K_COMMAND] = own[OWN_COMMAND];
        double displacement = creep_inverse(m + at[K_CREEP], own[OWN_COMMAND]);
        voltage = inverse(m + at[KX_INVERSE], m + at[K_HYSTERESIS], m + at[KX_HYSTERESIS], displacement);
        double bias = out[K_BIAS];
        if (bias != 0.0) {
            voltage += bias;
            bias *= m[at[K_OUT]];
            out[K_BIAS] = fabs(bias) > 1e-9 ? bias : 0.0;
        }
        voltage = compensator_hold(model, m, at, voltage, foreign);
        out[K_BIAS] = towards(difference, out[K_BIAS], own_p[K_SAFE_STEP]);
    } else {
        if (mode != M_RUNNING && mode != M_HOLDING)
            own[K_RETURNING] = 1.0;
        double step = skipped ? 0.0 : own_p[K_SAFE_STEP];
        voltage = compensator_hold(model, m, at, towards(limited[UNQUANTISED], own_p[SAFE_VOLTAGE], step), foreign);
    }
    row[R_VOLTAGE] = voltage;
    row[R_APPLIED] = out[K_APPLIED];
    row[SATURATED] = fmod(limited[FLAGS], 4.0) != 0.0 ? 1.0 : 0.0;
    row[COMPENSATOR_MODE] = mode;
    row[ADAPTATION] = 0.0;
    row[ADAPTED_GAIN] = 1.0;
}

/* ---- models/actuator.py and loop/plant.py ------------------------------------------------------------------------ */

enum { LIMIT, FORGIVEN, T_LOWEST, T_HIGHEST };
enum { TRIP, T_LATE, IN_ROW, LEVEL, MODE };

static inline void sense(double *m, const int64_t *at, double *row, int64_t *foreign)
{
    begin_sample(m + at[PWX_FAULTS]);
    double displacement = linear_output(m + at[P_DYNAMICS], m + at[PX_DYNAMICS]) + m[at[P_SENSOR] + 3];
    m[at[PX_SENSOR] + 9] = displacement;
    row[R_MEASURED] = sensor(m + at[P_SENSOR], m + at[PX_SENSOR], displacement, foreign);
    row[FORCE] = NAN;
    row[R_DISPLACEMENT] = displacement;
    row[PLANT_VOLTAGE] = m[at[PX_LIMITS] + OUTPUT];
    row[TRIPPED] = m[at[PWX_TRIP] + TRIP];
}

static inline void actuate(Hysteresis hysteresis, double *m, const int64_t *at, double *row, int64_t *foreign)
{
    const double *trip_p = m + at[PW_TRIP], *hold_p = m + at[PW_HOLD];
    double *trip = m + at[PWX_TRIP], *held = m + at[PWX_HOLD];
    *foreign += m[at[PW_FAULTS]] != 0.0;
    double voltage = row[SKIPPED] != 0.0 ? NAN : row[R_VOLTAGE], measured = row[R_MEASURED];
    double late = held[HELD_BEGUN] != 0.0 && !finite(voltage) ? 1.0 : 0.0;
    trip[T_LATE] += late;
    trip[IN_ROW] = (trip[IN_ROW] + 1.0) * late;
    trip[LEVEL] = larger(trip[LEVEL] - trip_p[FORGIVEN], 0.0) + late;
    if (trip_p[LIMIT] > 0.0 && (trip[IN_ROW] > trip_p[LIMIT] || trip[LEVEL] > trip_p[LIMIT]))
        trip[TRIP] = 1.0;
    if (measured < trip_p[T_LOWEST] || measured > trip_p[T_HIGHEST])
        trip[TRIP] = 2.0;
    double put_out = hold_voltage(hold_p, held, voltage, trip[TRIP], -INFINITY);
    if (trip[TRIP] != 0.0)
        trip[MODE] = M_TRIPPED;
    else if (held[HELD_AGE] >= hold_p[HOLD_TIMEOUT])
        trip[MODE] = M_STALE;
    else
        trip[MODE] = late != 0.0 ? M_HOLDING : M_RUNNING;
    row[PLANT_MODE] = trip[MODE];
    row[LATE] = trip[T_LATE];
    double applied = limits(m + at[P_LIMITS], m + at[PX_LIMITS], put_out);
    double displacement = hysteresis(m + at[P_HYSTERESIS], m + at[PX_HYSTERESIS], applied);
    dynamics_advance(m + at[P_DYNAMICS], m + at[PX_DYNAMICS],
                     creep(m + at[P_CREEP], m + at[PX_CREEP], displacement, foreign));
    row[PLANT_VOLTAGE] = applied;
}

/* ---- loop/source.py, loop/tick.py and loop/axis_array.py --------------------------------------------------------- */

/* The models are arguments, as in the compiled loop, so the compiler does not know them. */
__attribute__((noipa)) int64_t run_axes(double *memory, const int64_t *at, int64_t stride, int64_t axes, int64_t samples, double *rows,
                 const double *setpoints, Hysteresis plant, Hysteresis model, Inverse inverse, Law law,
                 double (*waveform)(const double *, double *))
{
    int64_t foreign = 0;
    for (int64_t i = 0; i < axes; i++) {
        double *m = memory + i * stride, *row = rows + i * ROW;
        for (int64_t k = 0; k < samples; k++) {
            row[SETPOINT] = setpoints[i * samples + k];
            row[SKIPPED] = 0.0;
            sense(m, at, row, &foreign);
            double source_mode = M_RUNNING;
            if (row[TRIPPED] != 0.0) {
                foreign += m[at[SX_TRAJECTORY] + ACTIVE] != 0.0;
                row[REFERENCE] = m[at[SX_RANGE] + G_OUTPUT];
                source_mode = M_TRIPPED;
            } else {
                row[REFERENCE] = reference_step(m, at, row[SETPOINT], waveform, &foreign);
                if (m[at[SX_RANGE] + G_RUNNING] == 0.0)
                    source_mode = M_STOPPED;
            }
            double target = m[at[SX_TRAJECTORY] + T_TARGET];
            if (target < INFINITY)
                row[SETPOINT] = target;
            row[SOURCE_MODE] = source_mode;
            /* the waveform has no clock of a scan */
            row[WAVEFORM_SAMPLE] = -1.0, row[SCAN_EDGES] = 0.0;
            if (source_mode == M_RUNNING && m[at[SX_RANGE] + G_RUNNING] == 1.0)
                row[WAVEFORM_SAMPLE] = m[at[SX_WAVEFORM]] - 1.0;
            control(law, m, at, row, &foreign);
            compensate(model, inverse, m, at, row, &foreign);
            actuate(plant, m, at, row, &foreign);
            double tolerance = m[at[KW_OWN] + TOLERANCE];
            if (fabs(row[PLANT_VOLTAGE] - row[R_VOLTAGE]) > tolerance) {
                row[R_VOLTAGE] = row[PLANT_VOLTAGE];
                row[SATURATED] = 1.0;
            }
            if (finite(row[R_APPLIED])) {
                m[at[CX_CONTROLLER] + APPLIED] = row[R_APPLIED];
                m[at[CWX_OWN] + ACHIEVED] = row[R_APPLIED];
                m[at[CWX_OWN] + UNANSWERED] = 0.0;
                m[at[CWX_OWN] + ANSWERED] = 1.0;
            }
        }
    }
    return foreign;
}

int64_t run_kim2009(double *memory, const int64_t *at, int64_t stride, int64_t axes, int64_t samples, double *rows,
                    const double *setpoints)
{
    return run_axes(memory, at, stride, axes, samples, rows, setpoints, polynomial, polynomial, polynomial_inverse,
                    sliding_mode, hold);
}
