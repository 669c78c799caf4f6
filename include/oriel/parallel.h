/* Static work sharing. Results must not depend on how the range is cut: each index writes its own output. */
#ifndef ORIEL_PARALLEL_H
#define ORIEL_PARALLEL_H
/* Calls fn(user, begin, end) over [0, n) cut into chunks of `grain`, handed out to `threads` threads (1 = inline, <= 0 = one per core, at most 64). Returns when all are done.
 * Threads are started once and kept; no allocation after the first call with a given thread count. Not re-entrant from inside fn (runs inline there). */
void orl_parallel(int threads, int n, int grain, void (*fn)(void *user, int begin, int end), void *user);
int orl_cores(void);
#endif
