// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

/* Driver in C of the stage in stage_device.c.
 *
 *     gcc -O2 -fPIC -shared -I FOLDER_OF_hysteresis_driver.h stage_driver.c -o libstage.so
 *
 * The header is in the folder hysteresis_ros/hardware of the installed package. Options: name, that of the stage's shared
 * memory, and standstill [s], the time without a new sample after which the stage counts as dead.
 */
#include "stage.h"

#include "hysteresis_driver.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { OPTION = 1, ABSENT, FOREIGN, BUSY, MEMORY, DIED, STOPPED, RANGE, INTERVENED };

/* Time without a new sample after which the driver checks whether the stage has died [s]. */
static const double LOOK = 0.002;

/* Number of repeated reads of a measurement that is being written. */
enum { TRIES = 1000 };

struct device {
    struct stage *stage;
    int file;
    uint64_t sample;
    double seen, standstill;
};

/* Result of hysteresis_describe; a library serves one process, and its functions are not called concurrently. */
static char name[128] = "";
static char said[512];
static int other;

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static int32_t understand(struct device *own, const char *const *options)
{
    snprintf(name, sizeof name, "/stage");
    own->standstill = 0.2;
    for (; *options; options++) {
        const char *value = strchr(*options, '=');
        char *end = "x";
        if (value && !strncmp(*options, "standstill=", 11))
            own->standstill = strtod(value + 1, &end);
        else if (value && value[1] && !strncmp(*options, "name=", 5))
            snprintf(name, sizeof name, "%s%s", value[1] == '/' ? "" : "/", value + 1), end = "";
        if (*end) {
            snprintf(said, sizeof said, "%s", *options);
            return OPTION;
        }
    }
    return 0;
}

static int32_t attach(struct device *own)
{
    struct stat status;
    own->file = shm_open(name, O_RDWR, 0);
    if (own->file < 0 || !stage_locked(own->file, STAGE_DEVICE_LOCK))
        return ABSENT;
    if (fstat(own->file, &status) || (size_t)status.st_size < sizeof(struct stage))
        return FOREIGN;
    void *memory = mmap(NULL, sizeof(struct stage), PROT_READ | PROT_WRITE, MAP_SHARED, own->file, 0);
    if (memory == MAP_FAILED)
        return MEMORY;
    own->stage = memory;
    if (atomic_load(&own->stage->magic) != STAGE_MAGIC || atomic_load(&own->stage->version) != STAGE_VERSION)
        return FOREIGN;
    if (stage_lock(own->file, STAGE_MASTER_LOCK)) {
        other = atomic_load(&own->stage->master_process);
        return BUSY;
    }
    atomic_store(&own->stage->master_process, getpid());
    return 0;
}

static void detach(struct device *own)
{
    if (own->stage)
        munmap(own->stage, sizeof(struct stage));
    if (own->file >= 0)
        close(own->file);
    free(own);
}

int32_t hysteresis_open(const char *const *options, double sample_rate, struct hysteresis_capabilities *can,
                        void **device)
{
    (void)sample_rate;
    struct device *own = calloc(1, sizeof *own);
    if (!own)
        return MEMORY;
    own->file = -1;
    int32_t code = understand(own, options);
    if (!code)
        code = attach(own);
    if (code) {
        detach(own);
        return code;
    }
    can->joints = own->stage->joints, can->voltages = 1;
    can->minimum = own->stage->minimum, can->maximum = own->stage->maximum;
    can->highest_rate = own->stage->rate, can->watchdog = own->stage->watchdog;
    strcpy(can->position_unit, "m"), strcpy(can->voltage_unit, "V");
    own->sample = atomic_load(&own->stage->sample), own->seen = now();
    *device = own;
    return hysteresis_make_safe(own);
}

/* Tell whether the device still computes samples. */
static int32_t look(struct device *own, uint64_t sample)
{
    double time = now();
    if (sample != own->sample) {
        own->sample = sample, own->seen = time;
        return 0;
    }
    if (time - own->seen > LOOK && !stage_locked(own->file, STAGE_DEVICE_LOCK))
        return DIED;
    return time - own->seen > own->standstill ? STOPPED : 0;
}

int32_t hysteresis_read(void *device, double *positions)
{
    struct device *own = device;
    struct stage *stage = own->stage;
    for (int i = 0; i < TRIES; i++) {
        uint64_t before = atomic_load(&stage->sequence);
        uint64_t sample = atomic_load(&stage->sample);
        double position = atomic_load(&stage->position);
        if (before % 2 == 0 && before == atomic_load(&stage->sequence)) {
            positions[0] = position;
            return look(own, sample);
        }
    }
    /* interrupted in the middle of a sample: an error only if it lasts */
    int32_t code = look(own, own->sample);
    return code ? code : HYSTERESIS_NOTHING_NEW;
}

int32_t hysteresis_write(void *device, const double *voltages)
{
    struct stage *stage = ((struct device *)device)->stage;
    if (!(voltages[0] >= stage->minimum && voltages[0] <= stage->maximum))
        return RANGE;
    /* it may not have processed the later request for the safe state yet */
    if (atomic_load(&stage->intervened) && atomic_load(&stage->rested_for) == atomic_load(&stage->rests))
        return INTERVENED;
    atomic_store(&stage->wanted, voltages[0]);
    atomic_fetch_add(&stage->writes, 1);
    return 0;
}

int32_t hysteresis_make_safe(void *device)
{
    struct device *own = device;
    atomic_store(&own->stage->wanted, own->stage->safe);
    atomic_store(&own->stage->rested, atomic_load(&own->stage->writes));
    atomic_fetch_add(&own->stage->rests, 1);
    return stage_locked(own->file, STAGE_DEVICE_LOCK) ? 0 : DIED;
}

void hysteresis_close(void *device)
{
    struct device *own = device;
    atomic_store(&own->stage->master_process, 0);
    detach(own);
}

const char *hysteresis_describe(int32_t code)
{
    static char text[768];
    static const char *const meanings[] = {
        [ABSENT] = "stage %s is not there; start `stage_device %s`",
        [FOREIGN] = "stage %s is something else, or of another version; remove /dev/shm%s",
        [MEMORY] = "the memory of stage %s cannot be reached; look at /dev/shm%s",
        [DIED] = "the process of stage %s has died; start `stage_device %s` again, then cleanup and configure",
        [STOPPED] = "the process of stage %s has stopped; check stage_device %s",
        [RANGE] = "stage %s refuses the voltage: it is not a number, or out of range; check the limits of %s",
        [INTERVENED] = "the watchdog of stage %s has output the safe voltage, because no voltage arrived in time; call "
                       "~/start when the axis may continue with %s",
    };
    if (code == OPTION)
        snprintf(text, sizeof text, "stage does not understand option %s; give name=NAME, standstill=SECONDS", said);
    else if (code == BUSY)
        snprintf(text, sizeof text, "stage %s has another master, process %d; end that first", name, other);
    else if (code > 0 && code < (int32_t)(sizeof meanings / sizeof *meanings) && meanings[code])
        snprintf(text, sizeof text, meanings[code], name, name);
    else
        snprintf(text, sizeof text, "stage %s has error %d; look at stage_driver.c", name, code);
    return text;
}
