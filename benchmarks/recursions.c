// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

/* The recursions of hysteresis_ros in C, operation by operation as in the Python sources named at each function.
 *
 * bench_kernels.py compiles this file with `gcc -O3` and compares its times with those of the compiled kernels. p and x
 * have the layouts of the Python modules; u, r and y are signals of n samples.
 */

#include <math.h>
#include <stddef.h>

typedef const double *restrict Parameters;
typedef double *restrict State;

static inline double smaller(double a, double b) { return b < a ? b : a; }

static inline double larger(double a, double b) { return b > a ? b : a; }

/* ---- models/hysteresis/polynomial.py ----------------------------------------------------------------------------- */

enum { VIRGIN = 0, RISING_D = 3, RISING_C1 = 6, RISING_C2 = 9, FALLING_D = 12, FALLING_C1 = 15, FALLING_C2 = 18 };
enum { VOLTAGE_HIGH = 21 };
enum { VOLTAGE, DISPLACEMENT, DIRECTION, TURN_VOLTAGE, TURN_DISPLACEMENT, V_MAX, V_LOW, ON_VIRGIN, LOWER_OFFSET };
enum { VIRGIN_OFFSET = 9, VIRGIN_FROM = 10, POLYNOMIAL_STATES = 11 };

static inline double coefficient(const double *p, int index, double v_max)
{
    return p[index] + v_max * (p[index + 1] + v_max * p[index + 2]);
}

static inline double virgin_curve(const double *p, const double *x, double voltage)
{
    double y = p[VIRGIN] + voltage * (p[VIRGIN + 1] + voltage * p[VIRGIN + 2]);
    double offset = x[VIRGIN_OFFSET];
    if (offset != 0.0) {
        double start = x[VIRGIN_FROM], end = p[VOLTAGE_HIGH];
        if (voltage <= start || start >= end)
            y += offset;
        else if (voltage < end)
            y += offset * ((end - voltage) / (end - start));
    }
    return y;
}

static inline double rising_curve(const double *p, double v_max, double voltage)
{
    double c2 = coefficient(p, RISING_C2, v_max);
    return coefficient(p, RISING_D, v_max) + voltage * (coefficient(p, RISING_C1, v_max) + voltage * c2);
}

static inline double falling_curve(const double *p, double v_max, double voltage)
{
    double c2 = coefficient(p, FALLING_C2, v_max);
    return coefficient(p, FALLING_D, v_max) + voltage * (coefficient(p, FALLING_C1, v_max) + voltage * c2);
}

static inline void turn_up(double *x)
{
    x[TURN_VOLTAGE] = x[VOLTAGE];
    x[TURN_DISPLACEMENT] = x[DISPLACEMENT];
    x[V_LOW] = smaller(x[V_LOW], x[VOLTAGE]);
    x[DIRECTION] = 1.0;
}

static inline void turn_down(const double *p, double *x)
{
    double voltage = x[VOLTAGE];
    x[TURN_VOLTAGE] = voltage;
    x[TURN_DISPLACEMENT] = x[DISPLACEMENT];
    if (voltage > x[V_MAX]) {
        x[V_MAX] = voltage;
        x[V_LOW] = 0.0;
        x[LOWER_OFFSET] = 0.0;
    }
    if (voltage <= x[V_LOW])
        x[LOWER_OFFSET] = x[DISPLACEMENT] - falling_curve(p, x[V_MAX], voltage);
    x[DIRECTION] = -1.0;
}

static inline double polynomial(const double *p, double *x, double u)
{
    double y;
    if (u > x[VOLTAGE]) {
        if (x[DIRECTION] < 0.0)
            turn_up(x);
        double v_max = x[V_MAX];
        if (u >= v_max) {
            x[ON_VIRGIN] = 1.0;
            y = virgin_curve(p, x, u);
        } else {
            x[ON_VIRGIN] = 0.0;
            double v_t = x[TURN_VOLTAGE];
            double start = x[TURN_DISPLACEMENT] - rising_curve(p, v_max, v_t);
            double end = virgin_curve(p, x, v_max) - rising_curve(p, v_max, v_max);
            y = rising_curve(p, v_max, u) + (start * (v_max - u) + end * (u - v_t)) / (v_max - v_t);
        }
    } else if (u < x[VOLTAGE]) {
        if (x[DIRECTION] > 0.0)
            turn_down(p, x);
        x[ON_VIRGIN] = 0.0;
        double v_low = x[V_LOW];
        y = falling_curve(p, x[V_MAX], u) + x[LOWER_OFFSET];
        if (u > v_low) {
            double v_t = x[TURN_VOLTAGE];
            double start = x[TURN_DISPLACEMENT] - falling_curve(p, x[V_MAX], v_t) - x[LOWER_OFFSET];
            y += start * (u - v_low) / (v_t - v_low);
        }
    } else {
        return x[DISPLACEMENT];
    }
    x[VOLTAGE] = u;
    x[DISPLACEMENT] = y;
    return y;
}

void run_polynomial(Parameters p, State x, const double *restrict u, double *restrict y, size_t n)
{
    for (size_t k = 0; k < n; k++)
        y[k] = polynomial(p, x, u[k]);
}

static inline double root_of(double rise, double slope, double bend)
{
    double discriminant = slope * slope + 4.0 * bend * rise;
    if (discriminant <= 0.0)
        return bend != 0.0 ? -slope / (2.0 * bend) : 0.0;
    double root = sqrt(discriminant);
    if (slope >= 0.0)
        return 2.0 * rise / (slope + root);
    return bend != 0.0 ? (root - slope) / (2.0 * bend) : rise / slope;
}

static inline double virgin_voltage(const double *p, const double *x, double displacement)
{
    double offset = x[VIRGIN_OFFSET], start = x[VIRGIN_FROM], end = p[VOLTAGE_HIGH];
    double level = p[VIRGIN], slope = p[VIRGIN + 1];
    if (offset != 0.0) {
        if (start >= end) {
            level += offset;
        } else if (displacement < virgin_curve(p, x, end)) {
            level += offset * end / (end - start);
            slope -= offset / (end - start);
        }
    }
    return root_of(displacement - level, slope, p[VIRGIN + 2]);
}

static inline double polynomial_inverse(double *x, const double *p, const double *x_h, double displacement)
{
    for (int i = 0; i < POLYNOMIAL_STATES; i++)
        x[i] = x_h[i];
    double voltage = x[VOLTAGE];
    if (displacement > x[DISPLACEMENT]) {
        if (x[DIRECTION] < 0.0)
            turn_up(x);
        double v_max = x[V_MAX];
        double top = virgin_curve(p, x, v_max);
        if (voltage >= v_max || displacement >= top)
            return larger(larger(virgin_voltage(p, x, displacement), voltage), v_max);
        double v_t = x[TURN_VOLTAGE], x_t = x[TURN_DISPLACEMENT];
        double start = x_t - rising_curve(p, v_max, v_t);
        double end = top - rising_curve(p, v_max, v_max);
        double bend = coefficient(p, RISING_C2, v_max);
        double slope = coefficient(p, RISING_C1, v_max) + 2.0 * bend * v_t + (end - start) / (v_max - v_t);
        return smaller(larger(v_t + root_of(displacement - x_t, slope, bend), voltage), v_max);
    }
    if (displacement < x[DISPLACEMENT]) {
        if (x[DIRECTION] > 0.0)
            turn_down(p, x);
        double v_max = x[V_MAX], v_low = x[V_LOW], offset = x[LOWER_OFFSET];
        double bend = coefficient(p, FALLING_C2, v_max);
        double slope = coefficient(p, FALLING_C1, v_max);
        if (voltage <= v_low || displacement <= falling_curve(p, v_max, v_low) + offset) {
            double level = coefficient(p, FALLING_D, v_max) + offset;
            return smaller(smaller(root_of(displacement - level, slope, bend), voltage), v_low);
        }
        double v_t = x[TURN_VOLTAGE], x_t = x[TURN_DISPLACEMENT];
        double start = x_t - falling_curve(p, v_max, v_t) - offset;
        slope += 2.0 * bend * v_t + start / (v_t - v_low);
        return larger(smaller(v_t + root_of(displacement - x_t, slope, bend), voltage), v_low);
    }
    return voltage;
}

/* Calculates the voltage for each displacement, and advances the model with it. */
void run_compensation(Parameters p, State x, State scratch, const double *restrict r, double *restrict voltage, size_t n)
{
    for (size_t k = 0; k < n; k++) {
        voltage[k] = polynomial_inverse(scratch, p, x, r[k]);
        polynomial(p, x, voltage[k]);
    }
}

/* ---- models/linear.py -------------------------------------------------------------------------------------------- */

enum { ORDER, FEEDTHROUGH, INPUT_SCALE, OUTPUT_SCALE, MATRICES };
enum { HELD_INPUT, STATE };

static inline void linear_advance(const double *p, double *x, double u)
{
    long n = (long)p[ORDER];
    long b = MATRICES + n * n;
    x[HELD_INPUT] = u;
    double u_model = u / p[INPUT_SCALE];
    for (long i = 0; i < n; i++) {
        double following = p[b + i] * u_model;
        long row = MATRICES + i * n;
        for (long j = 0; j < n; j++)
            following += p[row + j] * x[STATE + j];
        x[STATE + n + i] = following;
    }
    for (long i = 0; i < n; i++)
        x[STATE + i] = x[STATE + n + i];
}

static inline double linear_output(const double *p, const double *x)
{
    long n = (long)p[ORDER];
    long c = MATRICES + n * n + n;
    double y = p[FEEDTHROUGH] * (x[HELD_INPUT] / p[INPUT_SCALE]);
    for (long i = 0; i < n; i++)
        y += p[c + i] * x[STATE + i];
    return y * p[OUTPUT_SCALE];
}

void run_linear(Parameters p, State x, const double *restrict u, double *restrict y, size_t n)
{
    for (size_t k = 0; k < n; k++) {
        linear_advance(p, x, u[k]);
        y[k] = linear_output(p, x);
    }
}

/* ---- models/limits.py -------------------------------------------------------------------------------------------- */

enum { MINIMUM, MAXIMUM, SLEW, STEP };
enum { OUTPUT, FLAGS, LIMITED_SAMPLES, UNQUANTISED };
enum { RANGE = 1, SLEWING = 2, QUANTISED = 4 };
static const double NEGLIGIBLE = 1e-6;

static inline double limits(const double *p, double *x, double u)
{
    double flags = 0.0, last = x[UNQUANTISED], v = u;
    if (v != v) {
        v = last;
        flags += RANGE;
    } else if (v < p[MINIMUM]) {
        if (v < p[MINIMUM] - NEGLIGIBLE * (p[MAXIMUM] - p[MINIMUM]))
            flags += RANGE;
        v = p[MINIMUM];
    } else if (v > p[MAXIMUM]) {
        if (v > p[MAXIMUM] + NEGLIGIBLE * (p[MAXIMUM] - p[MINIMUM]))
            flags += RANGE;
        v = p[MAXIMUM];
    }
    double slew = p[SLEW];
    if (slew > 0.0) {
        if (v > last + slew) {
            v = last + slew;
            flags += SLEWING;
        } else if (v < last - slew) {
            v = last - slew;
            flags += SLEWING;
        }
    }
    x[UNQUANTISED] = v;
    if (flags > 0.0)
        x[LIMITED_SAMPLES] += 1.0;
    double step = p[STEP];
    if (step > 0.0) {
        double grid = smaller(p[MINIMUM] + floor((v - p[MINIMUM]) / step + 0.5) * step, p[MAXIMUM]);
        if (grid != v)
            flags += QUANTISED;
        v = grid;
    }
    x[FLAGS] = flags;
    x[OUTPUT] = v;
    return v;
}

void run_limits(Parameters p, State x, const double *restrict u, double *restrict y, size_t n)
{
    for (size_t k = 0; k < n; k++)
        y[k] = limits(p, x, u[k]);
}

/* ---- control/kalman.py, control/sliding_surface.py and control/sliding_mode.py ------------------------------------ */

#define BOUND 1e60

enum { K_ORDER, K_CURRENT, K_DISTURBED, K_FEEDTHROUGH, K_REST_INPUT, K_MATRICES };
enum { K_RUNNING, K_INNOVATION, K_OFFSET, K_ESTIMATE };
enum { S_FED, S_N, S_INTEGRATING, S_INPUT_SCALE, S_OUTPUT_SCALE, S_PRELOAD, S_REST_COMMAND, S_INTEGRAL_GAIN };
enum { S_INTEGRAL_HYPERPLANE = 8, S_SLOPE, S_LEVEL, S_WIDTH, S_THRESHOLD, S_MOVING, S_GAINS = 19 };
enum { APPLIED, ESTIMATED, SWITCHING, COMMAND, DISTURBANCE, STARTED, FEEDFORWARD };
enum { INTEGRAL = 7, LARGEST, LINEAR, TARGET, LAST = 13, BEGUN, OBSERVER };

static inline double bounded(double value)
{
    if (value != value)
        return 0.0;
    if (value > BOUND)
        return BOUND;
    if (value < -BOUND)
        return -BOUND;
    return value;
}

static inline double kalman_step(const double *p, double *x, double applied, double measured)
{
    long n = (long)p[K_ORDER], m = (long)p[K_DISTURBED];
    long a = K_MATRICES, b = a + n * n, c = b + n, gain = c + n, rest = gain + n;
    long transition = rest + n, shown = transition + m * m, correction = shown + m, through = correction + m;
    long now = K_ESTIMATE, following = now + n, cause = following + n, coming = cause + m;
    if (x[K_RUNNING] == 0.0) {
        x[K_RUNNING] = 1.0;
        x[K_INNOVATION] = 0.0;
        for (long i = 0; i < n; i++)
            x[now + i] = bounded(p[rest + i] * measured);
        for (long i = 0; i < m; i++)
            x[cause + i] = 0.0;
        x[K_OFFSET] = 0.0;
        if (m > 0) {
            x[cause] = bounded(p[K_REST_INPUT] * measured - applied);
            x[K_OFFSET] = x[cause];
        }
        return measured;
    }
    double late = p[K_CURRENT] == 0.0 ? x[K_INNOVATION] : 0.0;
    double entering = applied + x[K_OFFSET];
    for (long i = 0; i < n; i++) {
        double value = p[b + i] * entering + p[gain + i] * late;
        for (long j = 0; j < n; j++)
            value += p[a + i * n + j] * x[now + j];
        x[following + i] = bounded(value);
    }
    for (long i = 0; i < n; i++)
        x[now + i] = x[following + i];
    for (long i = 0; i < m; i++) {
        double value = p[correction + i] * late;
        for (long j = 0; j < m; j++)
            value += p[transition + i * m + j] * x[cause + j];
        x[coming + i] = bounded(value);
    }
    double offset = 0.0, output = p[K_FEEDTHROUGH] * applied;
    for (long i = 0; i < m; i++) {
        x[cause + i] = x[coming + i];
        offset += p[shown + i] * x[cause + i];
        output += p[through + i] * x[cause + i];
    }
    for (long i = 0; i < n; i++)
        output += p[c + i] * x[now + i];
    double innovation = bounded(measured - output);
    x[K_INNOVATION] = innovation;
    if (p[K_CURRENT] != 0.0) {
        for (long i = 0; i < n; i++) {
            double change = p[gain + i] * innovation;
            x[now + i] = bounded(x[now + i] + change);
            output += p[c + i] * change;
        }
        offset = 0.0;
        for (long i = 0; i < m; i++) {
            x[cause + i] = bounded(x[cause + i] + p[correction + i] * innovation);
            offset += p[shown + i] * x[cause + i];
        }
    }
    x[K_OFFSET] = bounded(offset);
    return output;
}

static inline double sliding_mode(const double *p, double *x, double reference, double measured)
{
    long n = (long)p[S_N];
    long hyperplane = S_GAINS + n, observer = hyperplane + n, b = observer + K_MATRICES + n * n, rest = b + 3 * n;
    long ahead = OBSERVER + K_ESTIMATE + 2 * (n + (long)p[observer + K_DISTURBED]);
    double applied = bounded(x[APPLIED]);
    if (fabs(applied) > x[LARGEST])
        x[LARGEST] = fabs(applied);
    double r = bounded(reference) / p[S_OUTPUT_SCALE];
    double y = (bounded(measured) - p[S_PRELOAD]) / p[S_OUTPUT_SCALE];
    if (x[STARTED] == 0.0) {
        x[STARTED] = 1.0;
        x[OBSERVER + K_RUNNING] = 0.0;
        for (long i = 0; i < n; i++)
            x[ahead + i] = bounded(p[rest + i] * r);
    }
    double estimated = kalman_step(p + observer, x + OBSERVER, applied / p[S_INPUT_SCALE], y);
    double s = 0.0, linear = 0.0;
    if (p[S_MOVING] != 0.0) {
        double fed = bounded(x[FEEDFORWARD]) / p[S_INPUT_SCALE];
        x[TARGET] = fed;
        for (long i = 0; i < n; i++) {
            double distance = x[OBSERVER + K_ESTIMATE + i] - x[ahead + i];
            s += p[hyperplane + i] * distance;
            linear += p[S_GAINS + i] * distance;
            double following = p[b + i] * fed;
            long row = observer + K_MATRICES + i * n;
            for (long j = 0; j < n; j++)
                following += p[row + j] * x[ahead + j];
            x[ahead + n + i] = following;
        }
        for (long i = 0; i < n; i++)
            x[ahead + i] = bounded(x[ahead + n + i]);
    } else {
        x[TARGET] = p[S_REST_COMMAND] * r;
        for (long i = 0; i < n; i++) {
            double distance = x[OBSERVER + K_ESTIMATE + i] - p[rest + i] * r;
            s += p[hyperplane + i] * distance;
            linear += p[S_GAINS + i] * distance;
        }
    }
    if (p[S_INTEGRATING] != 0.0) {
        double error = r - y;
        double excess = x[COMMAND] - applied;
        double outward = -p[S_INTEGRAL_GAIN] * error * (excess / p[S_INPUT_SCALE]);
        if (!(fabs(excess) > p[S_THRESHOLD] * x[LARGEST] && outward > 0.0))
            x[INTEGRAL] = bounded(x[INTEGRAL] + error);
        s += p[S_INTEGRAL_HYPERPLANE] * x[INTEGRAL];
        linear += p[S_INTEGRAL_GAIN] * x[INTEGRAL];
    }
    x[LINEAR] = linear;
    x[ESTIMATED] = bounded(estimated * p[S_OUTPUT_SCALE] + p[S_PRELOAD]);
    s = bounded(s);
    double width = fabs(s) + p[S_WIDTH];
    double nonlinear = 0.0;
    if (width > 0.0)
        nonlinear = (p[S_SLOPE] * fabs(s) + p[S_LEVEL]) * (s / width);
    double command = bounded(x[TARGET] - x[OBSERVER + K_OFFSET] - x[LINEAR] - nonlinear);
    x[LAST] = command;
    x[BEGUN] = 1.0;
    command = bounded(command * p[S_INPUT_SCALE]);
    x[SWITCHING] = s;
    x[COMMAND] = command;
    x[DISTURBANCE] = bounded(x[OBSERVER + K_OFFSET] * p[S_INPUT_SCALE]);
    x[APPLIED] = command;
    return command;
}

void run_sliding_mode(Parameters p, State x, const double *restrict r, const double *restrict y, double *restrict u,
                      size_t n)
{
    for (size_t k = 0; k < n; k++)
        u[k] = sliding_mode(p, x, r[k], y[k]);
}
