/* Directions that walls face (facing.h): peaks of the normals' azimuths modulo a quarter turn, each of the four walls then refined by the mean of the normals around it. */
#include "trainer/facing.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { BINS = 90, SMOOTH = 4, APART = 20, REFINEMENTS = 8, LEAST = 200, ASKED = 1000000 };      /* BINS: degrees of a quarter turn; LEAST: points that a direction takes to be believed, of ASKED at most */
#define NEAR 0.966f                 /* cosine of 15 degrees: normals that tell where a direction is */
#define AROUND 0.866f               /* of 30 degrees: the ring around them, 1 / RING times as large */
#define RING 0.341f
#define GATHERS 1.25f               /* how much denser they lie than in the ring */
#define WANDER 0.985f               /* cosine of how far it may be from its square place, 10 degrees */
#define STANDS_OUT 1.6f             /* a peak over the mean of all azimuths */

/* Walls' azimuths, each peak spread over its neighbours, around the quarter. */
static void plan_histogram(const stereo *st, double out[BINS])
{
    double raw[BINS] = { 0 };
    for (uint32_t i = 0; i < st->npoints; i++) {
        const stereo_point *q = &st->points[i];
        if (fabsf(q->n[2]) > 0.5f) continue;
        double a = atan2(q->n[1], q->n[0]) / (M_PI / 2);
        raw[(int)((a - floor(a)) * BINS) % BINS] += q->weight;
    }
    for (int i = 0; i < BINS; i++) {
        out[i] = 0;
        for (int k = -SMOOTH; k <= SMOOTH; k++) out[i] += raw[(i + k + BINS) % BINS] * (SMOOTH + 1 - abs(k)) / ((SMOOTH + 1) * (SMOOTH + 1));
    }
}

/* Weighted sum of the normals near dir; how many they are. around: how many there are in the ring of as much again. */
static uint32_t near_sum(const stereo *st, const float dir[3], double sum[3], uint32_t *around)
{
    uint32_t n = 0, ring = 0;
    memset(sum, 0, 3 * sizeof *sum);
    for (uint32_t i = 0; i < st->npoints; i += 1 + st->npoints / ASKED) {
        const stereo_point *q = &st->points[i];
        float c = q->n[0] * dir[0] + q->n[1] * dir[1] + q->n[2] * dir[2];
        if (c < NEAR) { ring += c > AROUND; continue; }
        for (int a = 0; a < 3; a++) sum[a] += q->weight * q->n[a];
        n++;
    }
    *around = ring;
    return n;
}

/* Where normals gather. A level direction moves to their mean again and again, while it stays near its first place. */
static void add(const stereo *st, orl_facings *f, float x, float y, float z)
{
    float first[3] = { x, y, z }, dir[3] = { x, y, z };
    double sum[3];
    uint32_t n = 0, around = 0;
    for (int round = 0; round < (z == 0 ? REFINEMENTS : 1); round++) {
        n = near_sum(st, dir, sum, &around);
        double len = sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]), still = 0;
        if (z != 0 || !(len > 0)) break;
        for (int a = 0; a < 3; a++) still += sum[a] / len * first[a];
        if (still < WANDER) { memcpy(dir, first, sizeof dir); break; }
        for (int a = 0; a < 3; a++) dir[a] = (float)(sum[a] / len);
    }
    if (f->n < ORL_FACINGS && n >= LEAST && n > GATHERS * RING * around) memcpy(f->dir[f->n++], dir, sizeof dir);
}

void facings_find(const stereo *st, orl_facings *out)
{
    double h[BINS], mean = 0;
    memset(out, 0, sizeof *out);
    if (st->npoints < LEAST) return;
    plan_histogram(st, h);
    for (int i = 0; i < BINS; i++) mean += h[i] / BINS;
    add(st, out, 0, 0, 1);
    add(st, out, 0, 0, -1);
    for (int plan = 0; plan < 2; plan++) {
        int best = 0;
        for (int i = 1; i < BINS; i++) if (h[i] > h[best]) best = i;
        if (!(h[best] > STANDS_OUT * mean)) break;
        for (int k = 0; k < 4; k++) {
            double turn = ((best + 0.5) / BINS + k) * (M_PI / 2);
            add(st, out, (float)cos(turn), (float)sin(turn), 0);
        }
        for (int k = -APART; k <= APART; k++) h[(best + k + BINS) % BINS] = 0;
    }
}

void facings_square(const orl_facings *f, stereo *st)
{
    for (uint32_t i = 0; i < st->npoints; i++) orl_facing_turn(f, st->points[i].n);
}
