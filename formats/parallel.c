/* A pool of threads that is started once and kept (include/oriel/parallel.h). Waking a thread takes longer than many a section does: before they sleep, threads look out for the next one a while, if each has a core. */
#include "oriel/parallel.h"
#include <pthread.h>
#include <stdatomic.h>
#include <time.h>
#include <unistd.h>

enum { MAX_THREADS = 64, LOOK_OUT = 100000 };       /* ns */

static struct {
    pthread_mutex_t lock, busy;
    pthread_cond_t start, done;
    int started, wanted, cores;
    atomic_int running;
    atomic_uint generation;
    void (*fn)(void *, int, int);
    void *user;
    int n, grain;
    atomic_int next;
} pool = { .lock = PTHREAD_MUTEX_INITIALIZER, .busy = PTHREAD_MUTEX_INITIALIZER, .start = PTHREAD_COND_INITIALIZER, .done = PTHREAD_COND_INITIALIZER };

static _Thread_local int inside;

static void work(void)
{
    for (;;) {
        int b = atomic_fetch_add(&pool.next, pool.grain);
        if (b >= pool.n) return;
        int e = pool.n - b < pool.grain ? pool.n : b + pool.grain;
        pool.fn(pool.user, b, e);
    }
}

static long now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_nsec + 1000000000L * (t.tv_sec & 1);
}

static long since(long then) { long d = now() - then; return d < 0 ? d + 2000000000L : d; }

static void *thread_main(void *arg)
{
    int id = (int)(long)arg;
    unsigned seen = 0;
    inside = 1;
    pthread_mutex_lock(&pool.lock);
    for (;;) {
        if (id < pool.wanted && pool.wanted < pool.cores && seen == pool.generation) {
            pthread_mutex_unlock(&pool.lock);
            for (long then = now(); seen == atomic_load(&pool.generation) && since(then) < LOOK_OUT; ) { }
            pthread_mutex_lock(&pool.lock);
        }
        while (seen == pool.generation) pthread_cond_wait(&pool.start, &pool.lock);
        seen = pool.generation;
        if (id >= pool.wanted) continue;
        pthread_mutex_unlock(&pool.lock);
        work();
        pthread_mutex_lock(&pool.lock);
        if (--pool.running == 0) pthread_cond_signal(&pool.done);
    }
    return NULL;
}

int orl_cores(void)
{
    long n = sysconf(_SC_NPROCESSORS_ONLN);
    return n < 1 ? 1 : n > MAX_THREADS ? MAX_THREADS : (int)n;
}

void orl_parallel(int threads, int n, int grain, void (*fn)(void *, int, int), void *user)
{
    if (threads <= 0) threads = orl_cores();
    if (threads > MAX_THREADS) threads = MAX_THREADS;
    if (grain < 1) grain = 1;
    if (n <= 0) return;
    if (threads == 1 || inside || n <= grain) {
        for (int b = 0; b < n; b += grain) fn(user, b, n - b < grain ? n : b + grain);
        return;
    }
    pthread_mutex_lock(&pool.busy);             /* one parallel section at a time */
    pthread_mutex_lock(&pool.lock);
    if (!pool.cores) pool.cores = orl_cores();
    while (pool.started < threads - 1) {
        pthread_t t;
        if (pthread_create(&t, NULL, thread_main, (void *)(long)pool.started)) break;
        pthread_detach(t);
        pool.started++;
    }
    pool.fn = fn;
    pool.user = user;
    pool.n = n;
    pool.grain = grain;
    atomic_store(&pool.next, 0);
    pool.wanted = threads - 1 < pool.started ? threads - 1 : pool.started;
    pool.running = pool.wanted;
    pool.generation++;
    pthread_cond_broadcast(&pool.start);
    pthread_mutex_unlock(&pool.lock);
    inside = 1;
    work();
    inside = 0;
    for (long then = now(); atomic_load(&pool.running) > 0 && since(then) < LOOK_OUT; ) { }
    pthread_mutex_lock(&pool.lock);
    while (pool.running > 0) pthread_cond_wait(&pool.done, &pool.lock);
    pthread_mutex_unlock(&pool.lock);
    pthread_mutex_unlock(&pool.busy);
}
