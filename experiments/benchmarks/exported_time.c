/* The time of a step of an exported controller: median, 99.9 %, and largest, of five passes over a recorded run.
 *
 * Printed in units of the counter, then how many of those a nanosecond has. The time stamp counter runs at a fixed rate,
 * which is near the clock of most processors but not it. It may count in strides of tens of cycles, as long as a short
 * step: so the median is of blocks of steps, and of single steps only what is far longer. */
#include "axis.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static unsigned long long nanoseconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (unsigned long long)t.tv_sec * 1000000000ull + (unsigned long long)t.tv_nsec;
}

#if defined(__x86_64__)
#include <x86intrin.h>
static unsigned long long now(void)
{
    unsigned int core;
    return __rdtscp(&core);
}
#else
static unsigned long long now(void)
{
    return nanoseconds();
}
#endif

#define MOST 100000
#define PASSES 5
#define BLOCK 100

static axis_inputs rows[MOST];
static unsigned long long times[PASSES * MOST], blocks[PASSES * MOST / BLOCK];
static axis_controller controller;
static volatile REAL sink;

static int by_size(const void *a, const void *b)
{
    const unsigned long long x = *(const unsigned long long *)a, y = *(const unsigned long long *)b;
    return (x > y) - (x < y);
}

static void restart(void)
{
    axis_set_parameters(&controller, &axis_drive_file);
    axis_reset(&controller, rows[0].scale_position);
}

static void step(int row)
{
    axis_outputs out;
    axis_step(&controller, &rows[row], &out);
    sink = out.force;
}

int main(int argc, char **argv)
{
    static char line[8192];
    FILE *const file = fopen(argv[argc - 1], "r");
    int steps = 0, count = 0, block_count = 0;
    if (file == NULL || fgets(line, sizeof line, file) == NULL) {
        return 2;
    }
    while (steps < MOST && fgets(line, sizeof line, file) != NULL) {
        REAL *const row = (REAL *)&rows[steps++];
        char *rest = line;
        for (int i = 0; i < INPUTS; ++i) {
            row[i] = (REAL)strtod(rest, &rest);
            ++rest;
        }
    }
    fclose(file);
    const unsigned long long began = now(), clock_began = nanoseconds();
    for (int pass = 0; pass < PASSES; ++pass) {
        restart();
        for (int i = 0; i + BLOCK <= steps; i += BLOCK) {
            const unsigned long long begin = now();
            for (int j = i; j < i + BLOCK; ++j) {
                step(j);
            }
            blocks[block_count++] = now() - begin;
        }
        restart();
        for (int i = 0; i < steps; ++i) {
            const unsigned long long begin = now();
            step(i);
            times[count++] = now() - begin;
        }
    }
    const double rate = (double)(now() - began) / (double)(nanoseconds() - clock_began);
    qsort(times, (size_t)count, sizeof times[0], by_size);
    qsort(blocks, (size_t)block_count, sizeof blocks[0], by_size);
    printf("%g %llu %llu %.6g\n", (double)blocks[block_count / 2] / BLOCK, times[count / 1000 * 999], times[count - 1], rate);
    return 0;
}
