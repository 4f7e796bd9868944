// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

/* A piezo stage simulated by this process, with its own clock: hysteresis, then a resonance.
 *
 *     stage_device NAME [--rate HZ] [--watchdog S] [--gain M_PER_V] [--play V] [--frequency HZ] [--damping RATIO]
 *
 * NAME is that of its shared memory, e.g. /stage. It prints "ready" when a driver may connect, and ends with SIGTERM.
 * After SIGUSR1 it returns invalid values, after another one valid ones, to test an axis with
 * a broken sensor.
 */
#include "stage.h"

#include <errno.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static volatile sig_atomic_t leaving, nonsense;

static void leave(int number) { (void)number, leaving = 1; }
static void confuse(int number) { (void)number, nonsense = !nonsense; }

struct options {
    double rate, watchdog, gain, play, frequency, damping, minimum, maximum, safe;
};

/* Half of the displacement follows the voltage through a play, as rate-independent hysteresis; all of it through a
 * resonance, which is solved exactly over a sample of constant voltage. */
struct plant {
    double play, position, velocity;
    double c_pp, c_pv, c_vp, c_vv; /* one sample of the free oscillation */
};

static void plant_init(struct plant *plant, const struct options *given)
{
    double dt = 1.0 / given->rate, w = 2.0 * M_PI * given->frequency, decay = given->damping * w;
    double damped = w * sqrt(1.0 - given->damping * given->damping);
    double a = exp(-decay * dt), c = cos(damped * dt), s = sin(damped * dt) / damped;
    memset(plant, 0, sizeof *plant);
    plant->c_pp = a * (c + decay * s), plant->c_pv = a * s;
    plant->c_vp = -a * w * w * s, plant->c_vv = a * (c - decay * s);
}

static double plant_step(struct plant *plant, const struct options *given, double voltage)
{
    plant->play = fmin(fmax(plant->play, voltage - given->play), voltage + given->play);
    double rest = given->gain * (0.5 * voltage + 0.5 * plant->play), away = plant->position - rest;
    double position = rest + plant->c_pp * away + plant->c_pv * plant->velocity;
    plant->velocity = plant->c_vp * away + plant->c_vv * plant->velocity;
    plant->position = position;
    return position;
}

/* Output of the amplifier: the client's voltage within its own range, the safe one when no more voltages arrive. */
struct amplifier {
    uint64_t writes, rests;
    int armed, intervened;
    double voltage, heard; /* `heard`: when the last voltage was [s] */
};

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static void amplifier_step(struct amplifier *own, struct stage *stage)
{
    uint64_t rests = atomic_load(&stage->rests), writes = atomic_load(&stage->writes);
    if (rests != own->rests) {
        own->rests = rests, own->writes = atomic_load(&stage->rested);
        own->armed = own->intervened = 0, own->voltage = stage->safe;
    }
    if (writes != own->writes && !own->intervened) {
        own->writes = writes, own->heard = now(), own->armed = 1;
        double wanted = atomic_load(&stage->wanted);
        if (isfinite(wanted))
            own->voltage = fmin(fmax(wanted, stage->minimum), stage->maximum);
    }
    if (own->armed && now() - own->heard > stage->watchdog)
        own->armed = 0, own->intervened = 1, own->voltage = stage->safe;
}

static void publish(struct stage *stage, const struct amplifier *amplifier, uint64_t sample, double position)
{
    uint64_t before = atomic_load(&stage->sequence);
    atomic_store(&stage->sequence, before + 1);
    atomic_store(&stage->sample, sample);
    atomic_store(&stage->position, position);
    atomic_store(&stage->voltage, amplifier->voltage);
    atomic_store(&stage->intervened, (uint32_t)amplifier->intervened);
    atomic_store(&stage->rested_for, amplifier->rests);
    atomic_store(&stage->sequence, before + 2);
}

static void run(struct stage *stage, const struct options *given)
{
    struct plant plant;
    struct amplifier amplifier = {.voltage = given->safe};
    struct timespec start, until;
    plant_init(&plant, given);
    clock_gettime(CLOCK_MONOTONIC, &start);
    for (uint64_t sample = 1; !leaving; sample++) {
        /* missed samples are computed at once: the stage runs in real time */
        uint64_t due = (uint64_t)(1e9 * (double)sample / given->rate) + (uint64_t)start.tv_nsec;
        until.tv_sec = start.tv_sec + (time_t)(due / 1000000000u), until.tv_nsec = (long)(due % 1000000000u);
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
        amplifier_step(&amplifier, stage);
        double position = plant_step(&plant, given, amplifier.voltage);
        publish(stage, &amplifier, sample, nonsense ? NAN : position);
    }
}

static int parse(int count, char **words, struct options *given)
{
    struct { const char *name; double *value; } known[] = {
        {"--rate", &given->rate},           {"--watchdog", &given->watchdog},   {"--gain", &given->gain},
        {"--play", &given->play},           {"--frequency", &given->frequency}, {"--damping", &given->damping},
        {"--minimum", &given->minimum},     {"--maximum", &given->maximum},     {"--safe", &given->safe},
    };
    for (int i = 2; i < count; i += 2) {
        size_t k = 0, all = sizeof known / sizeof *known;
        while (k < all && strcmp(words[i], known[k].name))
            k++;
        char *end = "x";
        if (k < all && i + 1 < count)
            *known[k].value = strtod(words[i + 1], &end);
        if (*end) {
            fprintf(stderr, "stage_device: %s %s: not understood\n", words[i], i + 1 < count ? words[i + 1] : "");
            return 0;
        }
    }
    return 1;
}

/* Returns the shared memory with this process as its device, NULL when it is not available. */
static struct stage *take(const char *name, int *file)
{
    *file = shm_open(name, O_RDWR | O_CREAT, 0600);
    if (*file < 0 || stage_lock(*file, STAGE_DEVICE_LOCK) || ftruncate(*file, 0) ||
        ftruncate(*file, sizeof(struct stage))) {
        fprintf(stderr, "stage_device: %s: %s\n", name, strerror(errno));
        return NULL;
    }
    void *memory = mmap(NULL, sizeof(struct stage), PROT_READ | PROT_WRITE, MAP_SHARED, *file, 0);
    return memory == MAP_FAILED ? NULL : memory;
}

int main(int count, char **words)
{
    struct options given = {
        .rate = 20000.0, .watchdog = 0.1, .gain = 1e-7, .play = 5.0, .frequency = 700.0, .damping = 0.02,
        .minimum = -30.0, .maximum = 120.0, .safe = 0.0,
    };
    int file;
    if (count < 2 || !parse(count, words, &given)) {
        fprintf(stderr, "usage: stage_device NAME [--rate HZ] [--watchdog S] …\n");
        return 2;
    }
    struct stage *stage = take(words[1], &file);
    if (!stage)
        return 2;
    struct sigaction action = {.sa_handler = leave};
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    action.sa_handler = confuse;
    sigaction(SIGUSR1, &action, NULL);
    stage->device_process = getpid(), stage->joints = 1;
    stage->minimum = given.minimum, stage->maximum = given.maximum, stage->safe = given.safe;
    stage->rate = given.rate, stage->watchdog = given.watchdog;
    atomic_store(&stage->voltage, given.safe);
    atomic_store(&stage->version, STAGE_VERSION);
    atomic_store(&stage->magic, STAGE_MAGIC);
    printf("ready\n");
    fflush(stdout);
    run(stage, &given);
    shm_unlink(words[1]);
    return 0;
}
