// Copyright 2026 hysteresis_ros maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
// the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
// an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
// specific language governing permissions and limitations under the License.

/* The interface between a stage, which is a separate process, and its driver: a block of POSIX shared memory.
 *
 * Every field has one writer. Doubles and counters are read and written whole; related fields are guarded by a
 * counter that is odd while they are being written. Locks of the file show which processes are present: the kernel
 * releases them when a process ends for any reason.
 */
#ifndef STAGE_H
#define STAGE_H

#ifndef _GNU_SOURCE
#define _GNU_SOURCE /* locks that belong to an open file and not to a process */
#endif

#include <fcntl.h>
#include <stdatomic.h>
#include <stdint.h>
#include <string.h>
#include <sys/types.h>

#define STAGE_MAGIC 0x68797374u
#define STAGE_VERSION 1u

/* Bytes of the file that the device and its master lock. */
enum { STAGE_DEVICE_LOCK = 0, STAGE_MASTER_LOCK = 1 };

struct stage {
    /* written once by the device, the magic number last */
    _Atomic uint32_t magic, version;
    int32_t device_process;
    int32_t joints;
    double minimum, maximum, rate, watchdog, safe;

    /* written by the device at each of its own samples */
    _Atomic uint64_t sequence; /* odd: being written */
    _Atomic uint64_t sample;
    _Atomic double position;
    _Atomic double voltage;     /* output voltage [V] */
    _Atomic uint32_t intervened; /* 1: the watchdog has acted; voltages are ignored until the next rest */
    _Atomic uint64_t rested_for; /* number of `rests` that the device has processed */

    /* written by the master */
    _Atomic int32_t master_process;
    _Atomic double wanted;
    _Atomic uint64_t writes; /* voltages so far */
    _Atomic uint64_t rested; /* `writes` at the last rest: only later ones count */
    _Atomic uint64_t rests;  /* number of requests of the client for the safe state */
};

/* Lock a byte of the file for as long as it is open here; returns 0 when no other process has locked it. */
static inline int stage_lock(int file, off_t byte)
{
    struct flock lock;
    memset(&lock, 0, sizeof lock);
    lock.l_type = F_WRLCK, lock.l_whence = SEEK_SET, lock.l_start = byte, lock.l_len = 1;
    return fcntl(file, F_OFD_SETLK, &lock);
}

/* Return whether another process has locked a byte. */
static inline int stage_locked(int file, off_t byte)
{
    struct flock lock;
    memset(&lock, 0, sizeof lock);
    lock.l_type = F_WRLCK, lock.l_whence = SEEK_SET, lock.l_start = byte, lock.l_len = 1;
    return fcntl(file, F_OFD_GETLK, &lock) == 0 && lock.l_type != F_UNLCK;
}

#endif
