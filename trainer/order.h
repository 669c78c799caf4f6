/* Sorting numbers, and the medians and percentiles that are the reason for it. Arrays are sorted in place; no number (NaN) may be among them. */
#ifndef TRAINER_ORDER_H
#define TRAINER_ORDER_H
#include <stddef.h>

void order_floats(float *v, size_t n);
/* The value below which a share q of 0..1 lies, the nearest of v; 0 of none. */
double order_percentile(double *v, size_t n, double q);
double order_median(double *v, size_t n);       /* the mean of the middle two where n is even */
#endif
