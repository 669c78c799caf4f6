/* Checkpoints (checkpoint.h): written to a temporary file, fsync, rename, so that a kill at any moment leaves the last one whole. */
#include "trainer/checkpoint.h"
#include <errno.h>
#include <string.h>
#include <unistd.h>

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
    for (int l = 0; !e && l < SDF_LEVELS; l++) e = grid_load(&s->sdf[l], f, moments, path);
    for (int l = 0; !e && l < FEAT_LEVELS; l++) e = grid_load(&s->feat[l], f, moments, path);
    if (!e) e = grid_load(&s->codes, f, moments, path);
    return e ? e : grid_load(&s->transient, f, moments, path);
}

orl_err checkpoint_save(const char *path, const checkpoint_header *h, const stage1 *s1, const surface *surf, const stage2 *s2)
{
    char tmp[1100];
    snprintf(tmp, sizeof tmp, "%s.tmp%ld", path, (long)getpid());
    FILE *f = fopen(tmp, "wb");
    if (!f) return orl_fail(ORL_E_IO, "%s: %s", tmp, strerror(errno));
    checkpoint_header head = *h;
    memcpy(head.magic, "ORLCKPT1", 8);
    orl_err e = fwrite(&head, sizeof head, 1, f) == 1 ? ORL_OK : orl_fail(ORL_E_IO, "%s: write failed", tmp);
    if (!e && h->phase >= 2) e = surface_save(surf, f);
    if (!e && h->phase >= 2) e = stage2_save(s2, f, h->phase == 2);
    if (!e) e = stage1_save(s1, f, h->phase == 1);
    if (!e && (fflush(f) || fsync(fileno(f)))) e = orl_fail(ORL_E_IO, "%s: %s", tmp, strerror(errno));
    fclose(f);
    if (!e && rename(tmp, path)) e = orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
    if (e) unlink(tmp);
    return e;
}

orl_err checkpoint_peek(const char *path, checkpoint_header *h, FILE **out)
{
    FILE *f = fopen(path, "rb");
    if (!f) return orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
    if (fread(h, sizeof *h, 1, f) != 1 || memcmp(h->magic, "ORLCKPT1", 8) || h->phase < 1 || h->phase > 3) {
        fclose(f);
        return orl_fail(ORL_E_FORMAT, "%s: not a checkpoint of this version", path);
    }
    *out = f;
    return ORL_OK;
}
