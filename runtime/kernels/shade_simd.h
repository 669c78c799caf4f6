/* The kernels of shade.h over vectors of 16-bit lanes, written once. An instruction set's file includes its vec_*.h, which gives the vector and what is done to it, names itself by ISA, and includes this. */
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define KERNEL(name) JOIN(orl_##name##_, ISA)

_Static_assert(ORL_KERNEL_STEP % LANES == 0, "no kernel has a tail");

INLINE vec zero(void) { return set1(0); }
INLINE vec share(vec v) { return add(shl(v, 7), shr(v, 1)); }

/* The end of the run of ORL_KERNEL_STEP pixels from i on, if it has a surface; else zeros, and i. */
INLINE int run_end(const uint8_t *cov, int i, int16_t *zeros)
{
    uint64_t run[ORL_KERNEL_STEP / 8], any = 0;
    memcpy(run, cov + i, sizeof run);
    for (size_t k = 0; k < sizeof run / sizeof *run; k++) any |= run[k];
    if (!any) memset(zeros + i, 0, ORL_KERNEL_STEP * sizeof *zeros);
    return any ? i + ORL_KERNEL_STEP : i;
}

/* ---- the sun */

/* In 16 bits: what an edge above 65535 has over it is added to what 65535 has over h. */
typedef struct { vec w0, w1, low, high, apart; int nearer; } edge;

INLINE edge edge_of(const orl_vis_tab *t, int32_t at)
{
    int more = at - 65535;
    return (edge){ set1(256 - t->f), set1(t->f), set1(at < 0 ? 0 : more > 0 ? 65535 : at), set1(more < 0 ? 0 : more > ORL_VIS_SPAN ? ORL_VIS_SPAN : more), set1(t->apart), t->f >= 128 };
}

INLINE vec lit(const uint8_t *const p[2], int i, const edge *e)
{
    vec a = load_u8(p[0] + i), b = load_u8(p[1] + i), h = where_greater(sub(max(a, b), min(a, b)), e->apart, shl(e->nearer ? b : a, 8), add(mullo(a, e->w0), mullo(b, e->w1)));
    vec d = minu(addu(subu(e->low, h), e->high), set1(ORL_VIS_SPAN)), t = shl(mul(shl(d, 3), set1(20182)), 1);
    vec q = mul(t, t), m = mul(q, sub(set1(32767), t));
    return adds(adds(q, m), m);
}

void KERNEL(vis)(const orl_vis_in *in, const orl_vis_tab *t, int n, int16_t *vis)
{
    const edge over = edge_of(t, t->over), under = edge_of(t, t->under);
    for (int run = 0; run < n; run += ORL_KERNEL_STEP) for (int i = run, end = run_end(in->cov, run, vis); i < end; i += LANES) {
        vec v = lit(in->horizon, i, &over);
        if (in->ceiling[0]) v = mul(v, lit(in->ceiling, i, &under));
        if (in->fix) v = max(adds(v, mullo(load_i8(in->fix + i), set1(258))), zero());
        store(vis + i, v);
    }
}

/* ---- shadow features */

void KERNEL(shadow)(const int8_t *const phi[2], const uint8_t *cov, const orl_shade_tab *t, int n, int16_t *s)
{
    const table s0 = table_of(t->shadow[0]), s1 = table_of(t->shadow[1]), s2 = table_of(t->shadow[2]);
    const phi_weights w = phi_weights_of(t);
    for (int run = 0; run < n; run += ORL_KERNEL_STEP) for (int i = run, end = run_end(cov, run, s); i < end; i += LANES) {
        vec x = phi_sum(phi[0] + ORL_PHI_GROUP * i, phi[1] + ORL_PHI_GROUP * i, &w), f = shl(and(x, set1(2047)), 4);
        picker at = picker_of(shr(x, 11));
        store(s + i, add(pick(s0, at), mul(f, add(pick(s1, at), mul(f, pick(s2, at))))));
    }
}

/* ---- surface, sky, tone */

/* A chain of products takes longer than a CPU can look ahead over, so WIDE vectors go through every step side by side: `each` of them. */
#define WIDE 2
#define each(q) for (int q = 0; q < wide; q++)
#define channels(c) for (int c = 0; c < 3; c++)

/* E^(5/12). */
INLINE void roots(int wide, vec e[WIDE][3], power_table factor)
{
    power p[WIDE][3];
    each(w) channels(c) p[w][c] = power_of(e[w][c]);
    each(w) channels(c) e[w][c] = add(set1(ORL_POW_2), mul(p[w][c].rest, set1(ORL_POW_3)));
    each(w) channels(c) e[w][c] = add(set1(ORL_POW_1), mul(p[w][c].rest, e[w][c]));
    each(w) channels(c) e[w][c] = add(set1(ORL_POW_0), mul(p[w][c].rest, e[w][c]));
    each(w) channels(c) e[w][c] = mul(e[w][c], pick_power(factor, p[w][c]));
}

INLINE void encode(int wide, vec u[WIDE][3])
{
    vec toe[WIDE][3], t[WIDE][3];
    each(w) channels(c) t[w][c] = shl(min(u[w][c], set1(ORL_TOE)), 5);
    each(w) channels(c) toe[w][c] = add(set1(ORL_TOE_2), mul(t[w][c], set1(ORL_TOE_3)));
    each(w) channels(c) t[w][c] = mul(t[w][c], t[w][c]);
    each(w) channels(c) u[w][c] = max(sub(u[w][c], set1(ORL_TOE_LINE)), mul(t[w][c], toe[w][c]));
}

/* A light's table in vectors: out of it, the compiler would fetch every entry again for every vector, since pixels that are written might be the table. */
typedef struct { vec sun_dir[3], sun[3], sky[3][ORL_SKY_TERMS], ground[3][2], no_shadow, gain, most, tone[3][3], tone_b[3]; power_table factor; int gain_shift, tone_shift; } constants;

INLINE void constants_of(const orl_shade_tab *t, constants *k)
{
    channels(c) {
        k->sun_dir[c] = set1(t->sun_dir[c]);
        k->sun[c] = set1(t->sun[c]);
        k->tone_b[c] = set1(t->tone_b[c]);
        for (int i = 0; i < ORL_SKY_TERMS; i++) k->sky[c][i] = set1(t->sky[c][i]);
        for (int i = 0; i < 2; i++) k->ground[c][i] = set1(t->ground[c][i]);
        for (int i = 0; i < 3; i++) k->tone[c][i] = set1(t->tone[c][i]);
    }
    k->no_shadow = set1(t->no_shadow);
    k->gain = set1(t->gain);
    k->gain_shift = t->gain_shift;
    k->tone_shift = t->tone_shift;
    k->most = set1(ORL_U_MAX >> t->gain_shift);
    k->factor = power_table_of(orl_power_factor);
}

INLINE void surface(int wide, const orl_shade_in *in, const constants *t, int i, vec e[WIDE][3])
{
    vec term[WIDE][ORL_SKY_TERMS - 1], sun[WIDE], open[WIDE], s[WIDE];
    each(w) {
        int at = i + w * LANES;
        vec *n = term[w], x = load_high(in->normal[0] + at), y = load_high(in->normal[1] + at), z = load_high(in->normal[2] + at);
        n[0] = x, n[1] = y, n[2] = z, n[3] = mul(x, y), n[4] = mul(y, z), n[5] = mul(z, x), n[6] = sub(mul(x, x), mul(y, y)), n[7] = mul(z, z);
        sun[w] = mul(max(add(add(mul(x, t->sun_dir[0]), mul(y, t->sun_dir[1])), mul(z, t->sun_dir[2])), zero()), load(in->vis + at));
        s[w] = mul(in->s ? load(in->s + at) : t->no_shadow, t->gain);
        open[w] = load_part(in->open + at);
    }
    channels(c) each(w) {
        vec sky = t->sky[c][0];
        for (int k = 1; k < ORL_SKY_TERMS; k++) sky = add(sky, mul(t->sky[c][k], term[w][k - 1]));
        e[w][c] = max(add(add(mul(t->sun[c], sun[w]), part(open[w], max(sky, zero()))), sub(t->ground[c][0], mul(t->ground[c][1], term[w][2]))), set1(2));
    }
    roots(wide, e, t->factor);
    each(w) channels(c) e[w][c] = min(mul(part(load_part(in->albedo[c] + i + w * LANES), s[w]), e[w][c]), t->most);
    if (t->gain_shift) each(w) channels(c) e[w][c] = shl_by(e[w][c], t->gain_shift);       /* a dazzling light, and rare */
    encode(wide, e);
}

/* Between two nodes, the first of which is that of column x. */
INLINE vec between(const int16_t *node, int x, int log2, vec ramp)
{
    vec a = nodes(node, x, log2);
    return add(a, mul(sub(nodes(node + 1, x, log2), a), ramp));
}

INLINE void shade_vectors(int wide, const orl_shade_in *in, const constants *k, int i, uint8_t *rgb)
{
    const int mask = (1 << in->sky_log2) - 1;
    vec p[WIDE][3], out[WIDE][3], cov[WIDE], least = set1(255), most = zero();
    each(w) {
        cov[w] = load_u8(in->cov + i + w * LANES);
        least = min(least, cov[w]);
        most = max(most, cov[w]);
        channels(c) p[w][c] = zero();
    }
    const int some = in->all || any(most), full = !in->all && all_255(least);
    if (some) surface(wide, in, k, i, p);
    if (!full) each(w) {
        int x = in->x + i + w * LANES;
        vec ramp = shl_by(and(add(set1(x & mask), lanes()), set1(mask)), 15 - in->sky_log2);
        channels(c) {
            vec y = between(in->sky[c], x, in->sky_log2, ramp);
            p[w][c] = some ? where_255(cov[w], p[w][c], add(y, mul(sub(p[w][c], y), share(cov[w])))) : y;
        }
    }
    each(w) channels(c) {
        vec v = k->tone_b[c];
        for (int q = 0; q < 3; q++) v = add(v, mul(k->tone[c][q], p[w][q]));
        out[w][c] = sar_by(v, k->tone_shift);
    }
    each(w) store_rgb(rgb + 3 * w * LANES, out[w]);
}

void KERNEL(shade)(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb)
{
    constants k;
    constants_of(t, &k);
    int i = 0;
    for (; i + WIDE * LANES <= n; i += WIDE * LANES) {
        if (i % 64 == 0) for (int q = 0; q < in->aheads; q++) __builtin_prefetch(in->ahead[q].at + i * in->ahead[q].step);
        shade_vectors(WIDE, in, &k, i, rgb + 3 * i);
    }
    for (; i < n; i += LANES) shade_vectors(1, in, &k, i, rgb + 3 * i);
}

/* ---- the photo */

/* 16 bytes of each row at a time: five pixels in words, first summed down, then along. */
INLINE half warp_part(const orl_warp_in *in, const uint8_t *p, const int16_t *row, int rows, int narrow, const int16_t *column)
{
    if (narrow) {
        half v = half_add(half_mullo(half_pixels(p), half_set1(row[0])), half_mullo(half_pixels(p + in->stride), half_set1(row[1])));
        v = half_mul(half_shr(v, 1), half_load(column));
        return half_add(v, half_down(v, 3));
    }
    pair v = pair_set1(0);
    for (int j = 0; j < rows; j++, p += in->stride) v = pair_add(v, pair_mullo(pair_pixels(p), pair_set1(row[j])));
    v = pair_mul(pair_shr(v, 1), pair_load(column));
    half lo = pair_low(v), hi = pair_high(v);                       /* R0 G0 B0 R1 G1 B1 R2 G2, B2 R3 G3 B3 R4 G4 B4 0 */
    return half_add(half_add(half_add(lo, half_down(lo, 3)), half_add(half_down(lo, 6), half_up(hi, 2))), half_add(half_down(hi, 1), half_down(hi, 4)));
}

INLINE void warp_pixel(const orl_warp_in *in, int64_t safe, int i, int narrow, uint8_t *rgb, int last)
{
    const orl_warp_at at = in->at[i];
    const int16_t *column = in->column + (narrow ? at.u * 16 : at.u * in->parts * 16), *row = in->row + at.v * ORL_WARP_ROWS;
    const uint8_t *from = in->photo + at.from;
    half sum = half_set1(64);
    if (at.from > safe) {                   /* vectors would read on beyond the photo's end */
        orl_warp_in one = *in;
        one.at += i;
        orl_warp_ref(&one, 1, rgb);
        return;
    }
    if (narrow) sum = half_add(sum, warp_part(in, from, row, 2, 1, column));
    else for (int k = 0; k < in->parts; k++) sum = half_add(sum, warp_part(in, from + 3 * ORL_WARP_PART * k, row, in->rows, 0, column + 16 * k));
    half_store_rgb(rgb, sum, last);
}

void KERNEL(warp)(const orl_warp_in *in, int n, uint8_t *rgb)
{
    const orl_warp_in own = *in;        /* which no pixel that is written can be */
    const int64_t safe = (int64_t)own.bytes - (int64_t)own.stride * ((own.narrow ? 2 : own.rows) - 1) - (own.narrow ? 8 : 3 * ORL_WARP_PART * own.parts + 1);
    int i = 0;
    if (own.narrow) for (; i < n - 1; i++) warp_pixel(&own, safe, i, 1, rgb + 3 * i, 0);
    else for (; i < n - 1; i++) warp_pixel(&own, safe, i, 0, rgb + 3 * i, 0);
    if (i < n) warp_pixel(&own, safe, i, own.narrow, rgb + 3 * i, 1);
}

INLINE void mix_vectors(int wide, const orl_mix_in *in, int i, uint8_t *rgb)
{
    const int mask = (1 << in->log2) - 1;
    vec ramp[WIDE], layer[WIDE], w[WIDE], r[WIDE][3], photo[WIDE][3], most = zero();
    int x[WIDE];
    each(q) {
        int at = i + q * LANES;
        x[q] = in->x + at + (mask + 1) / 2;
        vec column = and(add(set1(x[q] & mask), lanes()), set1(mask));
        ramp[q] = shl_by(add(add(column, column), set1(1)), 14 - in->log2);
        layer[q] = share(load_u8(in->layer + at));
        w[q] = load_u8(in->weight + at);
        most = max(most, w[q]);
        load_rgb(rgb + 3 * q * LANES, r[q]);
    }
    channels(c) each(q) {
        vec sky = between(in->node[c][0], x[q], in->log2, ramp[q]), stone = between(in->node[c][1], x[q], in->log2, ramp[q]), l = add(sky, mul(sub(stone, sky), layer[q]));
        r[q][c] = max(min(add(r[q][c], sar_by(add(l, set1(16)), 5)), set1(255)), zero());
    }
    if (any(most)) each(q) {
        load_rgb(in->photo + 3 * (i + q * LANES), photo[q]);
        channels(c) {
            vec m = add(add(mullo(photo[q][c], w[q]), mullo(r[q][c], sub(set1(255), w[q]))), set1(128));
            r[q][c] = shr(add(m, shr(m, 8)), 8);
        }
    }
    each(q) store_rgb(rgb + 3 * q * LANES, r[q]);
}

void KERNEL(mix)(const orl_mix_in *in, int n, uint8_t *rgb)
{
    const orl_mix_in own = *in;         /* which no pixel that is written can be */
    int i = 0;
    for (; i + WIDE * LANES <= n; i += WIDE * LANES) mix_vectors(WIDE, &own, i, rgb + 3 * i);
    for (; i < n; i += LANES) mix_vectors(1, &own, i, rgb + 3 * i);
}
