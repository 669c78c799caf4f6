/* Bump allocation out of a caller's 64-byte aligned block; with a NULL base it only counts, so that need and layout are the same code. */
#ifndef RUNTIME_ARENA_H
#define RUNTIME_ARENA_H
#include <stddef.h>
#include <stdint.h>

static inline size_t orl_align64(size_t n) { return (n + 63) & ~(size_t)63; }

typedef struct { uint8_t *base; size_t used; } orl_arena;
static inline void *orl_arena_take(orl_arena *a, size_t n)
{
    void *p = a->base ? a->base + a->used : NULL;
    a->used += orl_align64(n);
    return p;
}
#endif
