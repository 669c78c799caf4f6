/* Checkpoints (checkpoint.h): written to a temporary file, fsync, rename, so that a kill at any moment leaves the last one whole. What a kill leaves
 * of the temporary file, the next checkpoint overwrites. */
#include "trainer/checkpoint.h"
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "oriel/image.h"
#include "trainer/refine.h"

orl_err stage1_save(const stage1 *s, FILE *f, int moments)
{
    orl_err e = fwrite(&s->step, sizeof s->step, 1, f) == 1 ? ORL_OK : orl_fail(ORL_E_IO, "checkpoint: write failed");
    for (int l = 0; !e && l < SDF_LEVELS; l++) e = grid_save(&s->sdf[l], f, moments);
    for (int l = 0; !e && l < FEAT_LEVELS; l++) e = grid_save(&s->feat[l], f, moments);
    if (!e) e = grid_save(&s->codes, f, moments);
    return e ? e : grid_save(&s->transient, f, moments);
}

orl_err stage1_load(stage1 *s, FILE *f, int moments, const char *path)
{
    orl_err e = fread(&s->step, sizeof s->step, 1, f) == 1 ? ORL_OK : orl_fail(ORL_E_FORMAT, "%s: stage 1 header is cut short", path);
    if (!e && (s->step < 0 || s->step > s->opt.steps)) e = orl_fail(ORL_E_RANGE, "%s: stage 1 step %d of %d", path, s->step, s->opt.steps);
    for (int l = 0; !e && l < SDF_LEVELS; l++) e = grid_load(&s->sdf[l], f, moments, path);
    for (int l = 0; !e && l < FEAT_LEVELS; l++) e = grid_load(&s->feat[l], f, moments, path);
    if (!e) e = grid_load(&s->codes, f, moments, path);
    return e ? e : grid_load(&s->transient, f, moments, path);
}

static orl_err save_sky(const world *w, FILE *f)
{
    int bad = 0;
    for (int k = 0; k < w->nphotos; k++) {
        size_t n = world_label_bytes(&w->photos[k]);
        bad |= fwrite(w->photos[k].labels, 1, n, f) != n;
    }
    return bad ? orl_fail(ORL_E_IO, "checkpoint: write failed") : ORL_OK;
}

orl_err checkpoint_load_sky(world *w, FILE *f, const char *path)
{
    for (int k = 0; k < w->nphotos; k++) {
        size_t n = world_label_bytes(&w->photos[k]);
        if (fread(w->photos[k].labels, 1, n, f) != n) return orl_fail(ORL_E_FORMAT, "%s: sky labels of photo %d are cut short", path, k);
    }
    return ORL_OK;
}

#define MAGIC "ORLCKPTB"         /* a new number whenever what a checkpoint holds, or how grids lay it out, changes */

/* CRC of header and of what follows it in f. */
static int checksum(const checkpoint_header *h, FILE *f, uint32_t *crc)
{
    static uint8_t block[1 << 16];
    checkpoint_header head = *h;
    head.crc = 0;
    *crc = orl_crc32(&head, sizeof head, 0);
    if (fseek(f, sizeof head, SEEK_SET)) return 0;
    for (size_t n; (n = fread(block, 1, sizeof block, f));) *crc = orl_crc32(block, n, *crc);
    return !ferror(f);
}

orl_err checkpoint_save(const char *path, const checkpoint_header *h, const checkpoint_parts *p)
{
    char tmp[1100];
    snprintf(tmp, sizeof tmp, "%s.tmp", path);
    FILE *f = fopen(tmp, "w+b");
    if (!f) return orl_fail(ORL_E_IO, "%s: %s", tmp, strerror(errno));
    checkpoint_header head = *h;
    memcpy(head.magic, MAGIC, 8);
    orl_err e = fwrite(&head, sizeof head, 1, f) == 1 ? ORL_OK : ORL_E_IO;
    if (!e && h->phase == 0) e = stereo_work_save(p->maps, f);
    if (!e && h->phase == 1) e = stereo_save(p->st, f);
    if (!e && h->phase >= 2) e = surface_save(p->surf, f);
    if (!e && h->phase >= 2) e = stage2_save(p->s2, f, h->phase == 2);
    if (!e && h->phase >= 2) e = save_sky(p->w, f);
    if (!e && h->phase >= 1) e = stage1_save(p->s1, f, h->phase == 1);
    if (!e && h->phase >= 1) e = refine_save(p->w, f);
    if (e || fflush(f) || !checksum(&head, f, &head.crc) || fseek(f, 0, SEEK_SET) || fwrite(&head, sizeof head, 1, f) != 1 || fflush(f) || fsync(fileno(f))) e = orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
    fclose(f);
    if (!e && rename(tmp, path)) e = orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
    if (e) unlink(tmp);
    return e;
}

void checkpoint_note(checkpoint_header *h, const log_row *row)
{
    if (h->logged == LOG_ROWS) {
        h->logged = LOG_ROWS / 2;
        for (int i = 0; i < h->logged; i++) h->log[i] = h->log[2 * i + 1];
    }
    h->log[h->logged++] = *row;
}

static uint32_t hash(uint32_t h, const void *bytes, size_t n)   /* FNV-1a */
{
    for (const uint8_t *p = bytes; n--; p++) h = (h ^ *p) * 16777619u;
    return h;
}

uint32_t checkpoint_place(const world *w)
{
    uint32_t h = hash(2166136261u, w->frame.dims, sizeof w->frame.dims);
    for (int k = 0; k < w->nphotos; k++) {
        const world_photo *p = &w->photos[k];
        int32_t view[14] = { p->w, p->h };      /* rounded: compilers may differ in the last bits */
        for (int i = 0; i < 3; i++) view[2 + i] = (int32_t)lrint(16 * fmin(fmax(p->centre[i], -1e6), 1e6));
        for (int i = 0; i < 9; i++) view[5 + i] = (int32_t)lrint(4096 * p->axes[i]);
        h = hash(h, p->name, strlen(p->name) + 1);
        h = hash(h, view, sizeof view);
    }
    return h ? h : 1;
}

static int within(const checkpoint_header *h)
{
    const struct { int value, lo, hi; } range[] = {
        { h->phase, 0, 3 }, { h->long_side, 16, ORL_IMAGE_MAX_SIDE }, { h->longest, 16, 2048 }, { h->rays, 1, 1 << 24 }, { h->steps, 1, 10000000 },
        { h->pixels, 1, 1 << 24 }, { h->rounds, 1, 100000 }, { h->threads, 1, GRID_THREADS }, { h->nphotos, 2, 1000000 }, { h->dropped, 0, INT32_MAX },
    };
    for (size_t i = 0; i < sizeof range / sizeof *range; i++) if (range[i].value < range[i].lo || range[i].value > range[i].hi) return 0;
    if (h->logged < 0 || h->logged > LOG_ROWS || h->without >> WITHOUTS) return 0;
    for (int i = 0; i < h->logged; i++)
        for (size_t k = 0; k < sizeof(log_row) / sizeof(float); k++) if (!isfinite(((const float *)&h->log[i])[k])) return 0;
    return isfinite(h->seconds) && isfinite(h->cpu_seconds) && isfinite(h->samples);
}

orl_err checkpoint_peek(const char *path, checkpoint_header *h, FILE **out)
{
    FILE *f = fopen(path, "rb");
    if (!f) return orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
    checkpoint_header head;
    if (fread(&head, sizeof head, 1, f) != 1 || memcmp(head.magic, MAGIC, 8) || !within(&head)) {
        fclose(f);
        return orl_fail(ORL_E_FORMAT, "%s: not a checkpoint of this version", path);
    }
    uint32_t crc;
    if (!checksum(&head, f, &crc) || crc != head.crc || fseek(f, sizeof head, SEEK_SET)) {
        fclose(f);
        return orl_fail(ORL_E_FORMAT, "%s: damaged or cut short: its checksum differs", path);
    }
    *h = head;
    *out = f;
    return ORL_OK;
}

orl_err finished_open(const char *path, const orl_dataset *d, int threads, finished_run *r)
{
    FILE *f = NULL;
    memset(r, 0, sizeof *r);
    orl_err e = checkpoint_peek(path, &r->head, &f);
    if (e) return e;
    const checkpoint_header *h = &r->head;
    if (h->phase != 3) e = orl_fail(ORL_E_FORMAT, "%s: training has not finished (go on with fit --resume)", path);
    if (!e) e = world_load(d, h->long_side, h->longest, 1, threads, &r->w);
    if (!e && (h->nphotos != r->w.nphotos || (h->place && h->place != checkpoint_place(&r->w)))) e = orl_fail(ORL_E_FORMAT, "%s: made from other photos or cameras than those of %s", path, d->dir);
    if (!e) e = surface_load(&r->surf, f, path);
    if (!e) e = stage2_init(&r->s2, &r->w, &r->surf, NULL, NULL, &(stage2_options){ .without = h->without });
    if (!e && !(r->s2.codes = calloc((size_t)r->w.nphotos, sizeof *r->s2.codes))) e = orl_fail(ORL_E_MEMORY, "%s: no memory for codes", path);
    if (!e) e = stage2_load(&r->s2, f, 0, path);
    if (!e) e = checkpoint_load_sky(&r->w, f, path);
    fclose(f);
    if (e) finished_close(r);
    return e;
}

void finished_close(finished_run *r)
{
    stage2_free(&r->s2);
    surface_free(&r->surf);
    world_free(&r->w);
    memset(r, 0, sizeof *r);
}
