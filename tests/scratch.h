/* What the tests of readers share: a folder of their own under /tmp, files in it, and the warnings that a reader gave. */
#ifndef TESTS_SCRATCH_H
#define TESTS_SCRATCH_H
#include <dirent.h>
#include <ftw.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>
#include "oriel/error.h"

static char scratch[32];

/* Path under the scratch folder; valid for seven more calls. */
static inline __attribute__((format(printf, 1, 2))) const char *at(const char *fmt, ...)
{
    static char ring[8][2048];
    static int k;
    char *p = ring[k = (k + 1) & 7];
    va_list ap;
    int n = snprintf(p, sizeof ring[0], "%s/", scratch);
    va_start(ap, fmt);
    vsnprintf(p + n, sizeof ring[0] - (size_t)n, fmt, ap);
    va_end(ap);
    return p;
}

static inline int scratch_unlink(const char *path, const struct stat *st, int type, struct FTW *ftw)
{
    (void)st; (void)type; (void)ftw;
    return remove(path);
}

/* cmocka's setup and teardown of one test. */
static inline int scratch_make(void **state)
{
    (void)state;
    strcpy(scratch, "/tmp/orl_XXXXXX");
    return mkdtemp(scratch) ? 0 : -1;
}

static inline int scratch_remove(void **state)
{
    (void)state;
    return nftw(scratch, scratch_unlink, 16, FTW_DEPTH | FTW_PHYS);
}

/* Makes the folders that lead to a path. */
static inline void make_way(const char *path)
{
    char p[2048];
    snprintf(p, sizeof p, "%s", path);
    for (char *s = p + 1; (s = strchr(s, '/')); s++) {
        *s = 0;
        mkdir(p, 0777);
        *s = '/';
    }
}

static inline void put_bytes(const char *path, const void *bytes, size_t n)
{
    make_way(path);
    unlink(path);                   /* cheaper than to cut and refill */
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    assert_int_equal(fwrite(bytes, 1, n, f), n);
    assert_int_equal(fclose(f), 0);
}

static inline void put_text(const char *path, const char *text) { put_bytes(path, text, strlen(text)); }

static inline int entries(const char *dir)
{
    int n = -2;                     /* . and .. */
    DIR *d = opendir(dir);
    assert_non_null(d);
    while (readdir(d)) n++;
    closedir(d);
    return n;
}

/* Expects the code, and the text of the failure to be one line that holds every word given (NULL ends). */
static inline void failed(orl_err got, orl_err want, ...)
{
    const char *t = orl_error_text();
    if (got != want) fail_msg("got %d, want %d: %s", got, want, t);
    if (strchr(t, '\n') || !*t) fail_msg("not one line: `%s`", t);
    va_list ap;
    va_start(ap, want);
    for (const char *w; (w = va_arg(ap, const char *));) if (!strstr(t, w)) fail_msg("`%s` does not name `%s`", t, w);
    va_end(ap);
}

/* Expects success, and prints why not. */
static inline void ok(orl_err e) { if (e) fail_msg("%d: %s", e, orl_error_text()); }

typedef struct { int n; char line[32][700]; } warnings;

static inline void on_warn(void *user, const char *line)
{
    warnings *w = user;
    if (w->n < 32) snprintf(w->line[w->n], sizeof w->line[0], "%s", line);
    w->n++;
}

/* How many warnings hold both words. */
static inline int warned(const warnings *w, const char *a, const char *b)
{
    int n = 0;
    for (int i = 0; i < w->n && i < 32; i++) n += strstr(w->line[i], a) && strstr(w->line[i], b);
    return n;
}

/* Random numbers; the seed is printed, and set by SEED. */
static uint64_t seed;
static inline uint32_t rnd(void) { return (uint32_t)((seed = seed * 6364136223846793005u + 1442695040888963407u) >> 33); }
static inline double uniform(double lo, double hi) { return lo + (hi - lo) * rnd() / 2147483648.0; }
static inline void seed_print(void)
{
    const char *s = getenv("SEED");
    seed = s ? strtoull(s, NULL, 0) : (uint64_t)time(NULL) ^ (uint64_t)getpid() << 32;
    print_message("seed %llu\n", (unsigned long long)seed);
}
#endif
