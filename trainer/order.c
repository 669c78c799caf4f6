/* Sorted numbers (order.h). */
#include "trainer/order.h"
#include <stdlib.h>

static int by_float(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static int by_double(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

void order_floats(float *v, size_t n) { if (n) qsort(v, n, sizeof *v, by_float); }
static void order_doubles(double *v, size_t n) { if (n) qsort(v, n, sizeof *v, by_double); }

double order_percentile(double *v, size_t n, double q)
{
    order_doubles(v, n);
    return n ? v[(size_t)(q * (double)(n - 1) + 0.5)] : 0;
}

double order_median(double *v, size_t n)
{
    order_doubles(v, n);
    return n ? 0.5 * (v[(n - 1) / 2] + v[n / 2]) : 0;
}
