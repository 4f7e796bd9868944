// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

/* What a driver in C offers: the five methods of a driver (hysteresis_ros/hardware/driver.py) as functions of a shared
 * library. The package keeps the time: once a sample it calls hysteresis_read and, when the sample is over,
 * hysteresis_write. In the fused loop one thread calls them from machine code, without Python and its lock, so both
 * return within a small part of a sample: they neither wait nor allocate, nor write to a file.
 *
 * Two functions are never called at a time. A result of 0 is fine; any other one is an error code of the driver's own,
 * except HYSTERESIS_NOTHING_NEW: the axis is stopped then, hysteresis_make_safe is called at once and the device is left
 * alone until somebody starts the axis again.
 */
#ifndef HYSTERESIS_DRIVER_H
#define HYSTERESIS_DRIVER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Result of hysteresis_read: there is no measurement in this sample, and nothing is wrong. */
#define HYSTERESIS_NOTHING_NEW (-1)

/* What the device is able to do; all of it is zero before hysteresis_open fills it in. */
struct hysteresis_capabilities {
    int32_t joints;        /* positions that are read */
    int32_t voltages;      /* voltages that are put out */
    int32_t keeps_time;    /* 1: the device decides when a sample is; the package has no such loop and refuses it */
    int32_t reserved;
    double minimum;        /* range of what it can be told to put out [voltage_unit] */
    double maximum;
    double highest_rate;   /* samples per second [Hz] */
    double watchdog;       /* time without hysteresis_write after which the device goes to its safe state [s]; 0: none */
    char position_unit[8]; /* "m", or what the parameters calibration.sensor.unit and calibration.amplifier.unit */
    char voltage_unit[8];  /* "V"  of the plant's node have to name, for instance "count" */
};

/* Takes the device, which nobody else may use from now on, and leaves it in its safe state. `options` are what the
 * parameter file says, "NAME=VALUE" each, and end with NULL. `*device` is handed to all other functions. */
int32_t hysteresis_open(const char *const *options, double sample_rate, struct hysteresis_capabilities *can,
                        void **device);

/* Fills in the position of each joint [position_unit]. */
int32_t hysteresis_read(void *device, double *positions);

/* Puts out the voltages [voltage_unit] and holds them; all voltages of the device, those that the axis does not use are 0. */
int32_t hysteresis_write(void *device, const double *voltages);

/* Brings the device to its safe state, from any state; twice changes nothing. */
int32_t hysteresis_make_safe(void *device);

/* Lets go of the device, which is safe by then. Not called when hysteresis_open failed. */
void hysteresis_close(void *device);

/* Optional: says what an error code means, "PROBLEM; REMEDY", following the driver's name. Called after a failure. */
const char *hysteresis_describe(int32_t code);

#ifdef __cplusplus
}
#endif

#endif
