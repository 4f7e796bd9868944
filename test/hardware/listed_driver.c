// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

/* A driver in C without a device, for tests: 0.1 µm/V one call later; it notes what reaches it and fails when told to. */
#define _POSIX_C_SOURCE 199309L /* nanosleep */
#include "hysteresis_driver.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define NOTED 100000

static double voltages[NOTED], place;
static int64_t reads, writes, safes, closes, clocks, edges[NOTED][2], triggers, numbers[NOTED][2], asked;
static double delays[NOTED];
static int64_t fail_read, fail_write, fail_safe, nonsense, nothing, keeps_time, joints, fail_clock, fail_trigger, pulse;
static _Atomic int64_t block;
static char unit[8];

int64_t noted_reads(void) { return reads; }
int64_t noted_writes(void) { return writes; }
int64_t noted_safes(void) { return safes; }
int64_t noted_closes(void) { return closes; }
double noted_voltage(int64_t index) { return voltages[index]; }
int64_t noted_clocks(void) { return clocks; }
/* Which edges were output, and after how many voltages. */
int64_t noted_edges(int64_t index, int64_t place) { return edges[index][place]; }
int64_t noted_triggers(void) { return triggers; }
/* Number of a trigger, after how many voltages it was output, and its delay. */
int64_t noted_trigger(int64_t index, int64_t place) { return numbers[index][place]; }
double noted_delay(int64_t index) { return delays[index]; }
/* Fail, or do not return, at this call and all later ones; 0: never. */
void mend(void) { fail_read = fail_write = fail_safe = nonsense = nothing = block = fail_clock = fail_trigger = 0; }

int32_t hysteresis_open(const char *const *options, double sample_rate, struct hysteresis_capabilities *can,
                        void **device)
{
    static const char *const names[] = {"fail_read", "fail_write", "fail_safe", "nonsense", "nothing", "keeps_time",
                                        "joints", "fail_clock", "fail_trigger", "pulse"};
    int64_t *values[] = {&fail_read, &fail_write, &fail_safe, &nonsense, &nothing, &keeps_time, &joints,
                         &fail_clock, &fail_trigger, &pulse};
    reads = writes = safes = closes = clocks = keeps_time = triggers = asked = pulse = 0, place = 0.0, joints = 1;
    mend();
    strcpy(unit, "m");
    for (; *options; options++) {
        const char *value = strchr(*options, '=');
        size_t length = value ? (size_t)(value - *options) : 0, i = 0;
        while (i < 10 && (strlen(names[i]) != length || strncmp(*options, names[i], length)))
            i++;
        if (i < 10)
            *values[i] = atoll(value + 1);
        else if (value && !strncmp(*options, "block", 5))
            block = atoll(value + 1);
        else if (value && !strncmp(*options, "unit", 4))
            strncpy(unit, value + 1, sizeof unit - 1);
        else
            return 7;
    }
    can->joints = (int32_t)joints, can->voltages = 1, can->keeps_time = (int32_t)keeps_time;
    can->minimum = -30.0, can->maximum = 120.0, can->highest_rate = 1e6 + 0.0 * sample_rate, can->watchdog = 0.0;
    strcpy(can->position_unit, unit), strcpy(can->voltage_unit, "V");
    *device = &place;
    return 0;
}

int32_t hysteresis_read(void *device, double *positions)
{
    reads++;
    while (block && reads >= block)
        nanosleep(&(struct timespec){0, 1000000}, NULL);
    positions[0] = *(double *)device;
    if (nonsense && reads >= nonsense)
        positions[0] = nonsense % 2 ? NAN : -INFINITY;
    if (nothing && reads >= nothing) {
        positions[0] = 1e9;
        return HYSTERESIS_NOTHING_NEW;
    }
    return fail_read && reads >= fail_read ? 3 : 0;
}

int32_t hysteresis_write(void *device, const double *given)
{
    if (writes < NOTED)
        voltages[writes] = given[0];
    writes++;
    if (fail_write && writes >= fail_write)
        return 4;
    *(double *)device = 1e-7 * given[0];
    return 0;
}

int32_t hysteresis_clock(void *device, int64_t given)
{
    (void)device;
    if (clocks < NOTED)
        edges[clocks][0] = given, edges[clocks][1] = writes;
    clocks++;
    return fail_clock && clocks >= fail_clock ? 6 : 0;
}

int32_t hysteresis_trigger(void *device, int64_t number, double delay)
{
    (void)device;
    if (triggers < NOTED)
        numbers[triggers][0] = number, numbers[triggers][1] = writes, delays[triggers] = delay;
    triggers++;
    return fail_trigger && triggers >= fail_trigger ? 6 : 0;
}

/* Two pulses at each call whose number is a multiple of `pulse`. */
int32_t hysteresis_pulses(void *device, int64_t *count)
{
    (void)device;
    asked++;
    *count = pulse && asked % pulse == 0 ? 2 : 0;
    return pulse < 0 && asked >= -pulse ? 3 : 0;
}

int32_t hysteresis_make_safe(void *device)
{
    safes++;
    *(double *)device = 0.0;
    return fail_safe ? 5 : 0;
}

void hysteresis_close(void *device)
{
    (void)device;
    closes++;
}

const char *hysteresis_describe(int32_t code)
{
    static const char *const said[] = {[3] = "lost its sensor; plug it in", [4] = "lost its amplifier; plug it in",
                                       [5] = "does not listen; switch it off", [6] = "lost its outputs; plug them in",
                                       [7] = "does not know an option"};
    return code > 0 && code < 8 && said[code] ? said[code] : "is somehow ill";
}
