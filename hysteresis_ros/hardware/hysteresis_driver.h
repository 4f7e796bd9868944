// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

/* A driver in C: the five methods of a driver (hysteresis_ros/hardware/driver.py) as functions of a shared library.
 * The package sets the sample times: once per sample it calls hysteresis_read and, at the end of the sample,
 * hysteresis_write. In the fused loop one thread calls them from machine code, without Python and its lock, so both must
 * return within a small fraction of a sample: they must not wait, allocate memory, or write to a file.
 *
 * Two functions are never called at the same time. A result of 0 means success. Any other result, except
 * HYSTERESIS_NOTHING_NEW, is an error code of the driver: the axis is stopped, hysteresis_make_safe is called at once,
 * and the device is not used until the axis is started again.
 */
#ifndef HYSTERESIS_DRIVER_H
#define HYSTERESIS_DRIVER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Result of hysteresis_read: there is no measurement in this sample, and nothing is wrong. */
#define HYSTERESIS_NOTHING_NEW (-1)

/* Capabilities of the device; all fields are zero before hysteresis_open fills them in. */
struct hysteresis_capabilities {
    int32_t joints;        /* positions that are read */
    int32_t voltages;      /* voltages that are output */
    int32_t keeps_time;    /* 1: the device sets the sample times; the package has no such loop and refuses it */
    int32_t reserved;
    double minimum;        /* range of its output [voltage_unit] */
    double maximum;
    double highest_rate;   /* samples per second [Hz] */
    double watchdog;       /* time without hysteresis_write after which the device goes to its safe state [s]; 0: none */
    char position_unit[8]; /* "m", or what the parameters calibration.sensor.unit and calibration.amplifier.unit */
    char voltage_unit[8];  /* "V"  of the plant's node have to name, for instance "count" */
};

/* Takes the device for exclusive use, and leaves it in its safe state. `options` are those of the parameter file,
 * "NAME=VALUE" each, and end with NULL. `*device` is passed to all other functions. */
int32_t hysteresis_open(const char *const *options, double sample_rate, struct hysteresis_capabilities *can,
                        void **device);

/* Fills in the position of each joint [position_unit]. */
int32_t hysteresis_read(void *device, double *positions);

/* Outputs all voltages of the device [voltage_unit] and holds them; those that the axis does not use are 0. */
int32_t hysteresis_write(void *device, const double *voltages);

/* Brings the device to its safe state, from any state; idempotent. */
int32_t hysteresis_make_safe(void *device);

/* Releases the device, which is safe by then. Not called when hysteresis_open failed. */
void hysteresis_close(void *device);

/* Optional: outputs what begins at this sample of a scan, for instance as pulses of three digital lines. `edges` is a
 * sum of 1: a frame, 2: a line, 4: a pixel. Called after hysteresis_write of the same sample, and in skipped samples too,
 * if the parameter scan_clock of the plant's node is true; the fused loop calls it from machine code. */
int32_t hysteresis_clock(void *device, int64_t edges);

/* Optional: outputs trigger `number` (from 1), `delay` seconds after the exact instant, for instance as a pulse of a
 * digital line. Called after hysteresis_write of the same sample if the parameter trigger_output of the plant's node is
 * true; the fused loop calls it from machine code. */
int32_t hysteresis_trigger(void *device, int64_t number, double delay);

/* Optional: fills in the number of pulses at the trigger input since the last call. Called after hysteresis_read if the
 * parameter trigger_input of the plant's node is true. */
int32_t hysteresis_pulses(void *device, int64_t *count);

/* Optional: returns the meaning of an error code, "PROBLEM; REMEDY", to follow the driver's name. Called after a failure. */
const char *hysteresis_describe(int32_t code);

#ifdef __cplusplus
}
#endif

#endif
