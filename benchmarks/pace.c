// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

/* The reference loop of bench_realtime.py: it waits for each deadline like the fused loop, and computes nothing.

   pace RATE SAMPLES PRIORITY CPU writes the lateness of each sample [ns], int64, to standard output. PRIORITY 0 is the
   normal priority, CPU -1 any core. Exit code 3: the priority or the core is not permitted. */

#define _GNU_SOURCE
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <time.h>

static int64_t now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int main(int argc, char **argv)
{
    if (argc != 5) {
        fprintf(stderr, "pace RATE SAMPLES PRIORITY CPU\n");
        return 2;
    }
    const double period = 1e9 / atof(argv[1]);
    const int64_t samples = atoll(argv[2]);
    const int priority = atoi(argv[3]), cpu = atoi(argv[4]);
    int64_t *late = malloc(samples * sizeof *late);
    memset(late, 1, samples * sizeof *late);
    prctl(PR_SET_TIMERSLACK, 1UL, 0UL, 0UL, 0UL);
    if (priority) {
        struct sched_param wanted = {.sched_priority = priority};
        if (sched_setscheduler(0, SCHED_FIFO, &wanted)) return 3;
    }
    if (cpu >= 0) {
        cpu_set_t wanted;
        CPU_ZERO(&wanted);
        CPU_SET(cpu, &wanted);
        if (sched_setaffinity(0, sizeof wanted, &wanted)) return 3;
    }
    const int64_t origin = now() + 5000000;
    for (int64_t k = 0; k < samples; k++) {
        const int64_t deadline = origin + (int64_t)(k * period);
        int64_t begun = now();
        while (begun < deadline) {
            const struct timespec t = {deadline / 1000000000, deadline % 1000000000};
            clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
            begun = now();
        }
        late[k] = begun - deadline;
    }
    fwrite(late, sizeof *late, samples, stdout);
    return 0;
}
