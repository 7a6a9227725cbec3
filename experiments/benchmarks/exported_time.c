/* The time of each step of an exported controller: median, 99.9 %, and largest, of five passes over a recorded run.
 *
 * The time stamp counter runs at a fixed rate, which is near the clock of most processors but not it. */
#include "axis.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#if defined(__x86_64__)
#include <x86intrin.h>
static unsigned long long now(void)
{
    unsigned int core;
    return __rdtscp(&core);
}
#define UNIT "cycles"
#else
static unsigned long long now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (unsigned long long)t.tv_sec * 1000000000ull + (unsigned long long)t.tv_nsec;
}
#define UNIT "ns"
#endif

#define MOST 100000
#define PASSES 5

static axis_inputs rows[MOST];
static unsigned long long times[PASSES * MOST];

static int by_size(const void *a, const void *b)
{
    const unsigned long long x = *(const unsigned long long *)a, y = *(const unsigned long long *)b;
    return (x > y) - (x < y);
}

int main(int argc, char **argv)
{
    static char line[8192];
    static axis_controller controller;
    FILE *const file = fopen(argv[argc - 1], "r");
    int steps = 0, count = 0;
    unsigned long long empty = ~0ull;
    volatile REAL sink = 0;
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
    for (int i = 0; i < 1000; ++i) {
        const unsigned long long begin = now(), end = now();
        empty = end - begin < empty ? end - begin : empty;
    }
    for (int pass = 0; pass < PASSES; ++pass) {
        axis_set_parameters(&controller, &axis_drive_file);
        axis_reset(&controller, rows[0].reference_position);
        for (int i = 0; i < steps; ++i) {
            axis_outputs out;
            const unsigned long long begin = now();
            axis_step(&controller, &rows[i], &out);
            const unsigned long long end = now();
            sink = out.force;
            times[count++] = end - begin > empty ? end - begin - empty : 0;
        }
    }
    (void)sink;
    qsort(times, (size_t)count, sizeof times[0], by_size);
    printf("median %llu, 99.9 %% %llu, largest %llu " UNIT " a step", times[count / 2], times[count / 1000 * 999], times[count - 1]);
    return 0;
}
