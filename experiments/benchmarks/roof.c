/* What one core can do at most: arithmetic on vectors that stay in registers, and reading memory. */

#include <stddef.h>

enum { WIDTH = 8, CHAINS = 12 }; /* doubles of a vector; chains enough to hide an operation's latency */
typedef double vector __attribute__((vector_size(WIDTH * sizeof(double))));

#define KERNEL(name, expression)                                  \
    double name(long rounds, double start)                        \
    {                                                             \
        vector a[CHAINS], b = {0}, c = {0};                       \
        b += 0.5 + 0.1 * start;                                   \
        c += 0.25 + 0.1 * start;                                  \
        for (int k = 0; k < CHAINS; k++) a[k] = b + (double)k;    \
        for (long r = 0; r < rounds; r++) {                       \
            _Pragma("GCC unroll 12")                              \
            for (int k = 0; k < CHAINS; k++) a[k] = (expression); \
        }                                                         \
        vector sum = {0};                                         \
        for (int k = 0; k < CHAINS; k++) sum += a[k];             \
        double total = 0.0;                                       \
        for (int i = 0; i < WIDTH; i++) total += sum[i];          \
        return total;                                             \
    }

KERNEL(fused, a[k] * b + c)
KERNEL(added, a[k] + b)
KERNEL(multiplied, a[k] * b)
KERNEL(divided, c / a[k])

double read_through(const double *values, long n)
{
    vector sum[CHAINS] = {{0}};
    const vector *all = (const vector *)values;
    for (long i = 0; i + CHAINS * WIDTH <= n; i += CHAINS * WIDTH)
        for (int k = 0; k < CHAINS; k++) sum[k] += all[i / WIDTH + k];
    double total = 0.0;
    for (int k = 0; k < CHAINS; k++)
        for (int i = 0; i < WIDTH; i++) total += sum[k][i];
    return total;
}
