/* The kernels of shade.h over vectors of 16-bit lanes, written once. An instruction set's file includes its vec_*.h, which gives the vector and what is done to it, names itself by ISA, and includes this. */
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define KERNEL(name) JOIN(orl_##name##_, ISA)

_Static_assert(ORL_KERNEL_STEP % LANES == 0, "no kernel has a tail");

INLINE vec zero(void) { return set1(0); }
INLINE vec share(vec v) { return add(shl(v, 7), shr(v, 1)); }

/* ---- the sun */

/* In 16 bits: what an edge above 65535 has over it is added to what 65535 has over h. */
typedef struct { vec w0, w1, low, high; } edge;

INLINE edge edge_of(int f, int32_t at)
{
    int more = at - 65535;
    return (edge){ set1(256 - f), set1(f), set1(at < 0 ? 0 : more > 0 ? 65535 : at), set1(more < 0 ? 0 : more > ORL_VIS_SPAN ? ORL_VIS_SPAN : more) };
}

INLINE vec lit(const uint8_t *const p[2], int i, const edge *e)
{
    vec h = add(mullo(load_u8(p[0] + i), e->w0), mullo(load_u8(p[1] + i), e->w1));
    vec d = minu(addu(subu(e->low, h), e->high), set1(ORL_VIS_SPAN)), t = shl(mul(shl(d, 3), set1(20182)), 1);
    vec a = mul(t, t), m = mul(a, sub(set1(32767), t));
    return adds(adds(a, m), m);
}

void KERNEL(vis)(const orl_vis_in *in, const orl_vis_tab *t, int n, int16_t *vis)
{
    const edge over = edge_of(t->f, t->over), under = edge_of(t->f, t->under);
    for (int i = 0; i < n; i += LANES) {
        vec v = lit(in->horizon, i, &over);
        if (in->ceiling[0]) v = mul(v, lit(in->ceiling, i, &under));
        if (in->fix) v = max(adds(v, mullo(load_i8(in->fix + i), set1(258))), zero());
        store(vis + i, v);
    }
}

/* ---- shadow features */

void KERNEL(shadow)(const int8_t *const phi[2], const orl_shade_tab *t, int n, int16_t *s)
{
    const table s0 = table_of(t->shadow[0]), s1 = table_of(t->shadow[1]), s2 = table_of(t->shadow[2]);
    const phi_weights w = phi_weights_of(t);
    for (int i = 0; i < n; i += LANES) {
        vec x = phi_sum(phi[0] + ORL_PHI_GROUP * i, phi[1] + ORL_PHI_GROUP * i, &w), f = shl(and(x, set1(2047)), 4);
        picker at = picker_of(shr(x, 11));
        store(s + i, add(pick(s0, at), mul(f, add(pick(s1, at), mul(f, pick(s2, at))))));
    }
}

/* ---- surface, sky, tone */

/* E^(5/12), the channels' chains of products side by side. */
INLINE void roots(const vec e[3], table factor, vec r[3])
{
    power p[3];
    for (int c = 0; c < 3; c++) p[c] = power_of(e[c]);
    for (int c = 0; c < 3; c++) r[c] = add(set1(ORL_POW_2), mul(p[c].rest, set1(ORL_POW_3)));
    for (int c = 0; c < 3; c++) r[c] = add(set1(ORL_POW_1), mul(p[c].rest, r[c]));
    for (int c = 0; c < 3; c++) r[c] = add(set1(ORL_POW_0), mul(p[c].rest, r[c]));
    for (int c = 0; c < 3; c++) r[c] = mul(r[c], pick(factor, p[c].log));
}

INLINE vec encode(vec u)
{
    vec w = shl(min(u, set1(ORL_TOE)), 5);
    return max(sub(u, set1(ORL_TOE_LINE)), mul(mul(w, w), add(set1(ORL_TOE_2), mul(w, set1(ORL_TOE_3)))));
}

/* A light's table in vectors: out of it, the compiler would fetch every entry again for every vector, since pixels that are written might be the table. */
typedef struct { vec sun_dir[3], sun[3], sky[3][ORL_SKY_TERMS], ground[3][2], no_shadow, gain, most, tone[3][3], tone_b[3]; table factor; int gain_shift, tone_shift; } constants;

INLINE void constants_of(const orl_shade_tab *t, constants *k)
{
    for (int c = 0; c < 3; c++) {
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
    k->factor = table_of(orl_power_factor);
}

INLINE void surface(const orl_shade_in *in, const constants *t, int i, vec e[3])
{
    vec x = load_high(in->normal[0] + i), y = load_high(in->normal[1] + i), z = load_high(in->normal[2] + i);
    vec s = in->s ? load(in->s + i) : t->no_shadow, open = shl(load_u8(in->open + i), 7);
    vec sun = add(add(mul(x, t->sun_dir[0]), mul(y, t->sun_dir[1])), mul(z, t->sun_dir[2]));
    const vec term[ORL_SKY_TERMS - 1] = { x, y, z, mul(x, y), mul(y, z), mul(z, x), sub(mul(x, x), mul(y, y)), mul(z, z) };
    sun = mul(max(sun, zero()), load(in->vis + i));
    vec E[3], u[3];
    for (int c = 0; c < 3; c++) {
        vec sky = t->sky[c][0];
        for (int k = 1; k < ORL_SKY_TERMS; k++) sky = add(sky, mul(t->sky[c][k], term[k - 1]));
        E[c] = max(add(add(mul(t->sun[c], sun), mul(max(sky, zero()), open)), sub(t->ground[c][0], mul(t->ground[c][1], z))), set1(2));
    }
    roots(E, t->factor, u);
    for (int c = 0; c < 3; c++) u[c] = min(mul(mul(mul(shl(load_u8(in->albedo[c] + i), 7), s), u[c]), t->gain), t->most);
    if (t->gain_shift) for (int c = 0; c < 3; c++) u[c] = shl_by(u[c], t->gain_shift);        /* a dazzling light, and rare */
    for (int c = 0; c < 3; c++) e[c] = encode(u[c]);
}

/* Between two nodes, the first of which is that of column x. */
INLINE vec between(const int16_t *node, int x, int log2, vec ramp)
{
    vec a = nodes(node, x, log2);
    return add(a, mul(sub(nodes(node + 1, x, log2), a), ramp));
}

void KERNEL(shade)(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb)
{
    constants k;
    constants_of(t, &k);
    const int mask = (1 << in->sky_log2) - 1;
    for (int i = 0; i < n; i += LANES, rgb += 3 * LANES) {
        vec p[3] = { zero(), zero(), zero() }, out[3], cov = load_u8(in->cov + i);
        const int some = any(cov), full = all_255(cov);
        if (some) surface(in, &k, i, p);
        if (!full) {
            int x = in->x + i;
            vec ramp = shl_by(and(add(set1(x & mask), lanes()), set1(mask)), 15 - in->sky_log2);
            for (int c = 0; c < 3; c++) {
                vec y = between(in->sky[c], x, in->sky_log2, ramp);
                p[c] = some ? where_255(cov, p[c], add(y, mul(sub(p[c], y), share(cov)))) : y;
            }
        }
        for (int c = 0; c < 3; c++) {
            vec v = k.tone_b[c];
            for (int i = 0; i < 3; i++) v = add(v, mul(k.tone[c][i], p[i]));
            out[c] = sar_by(v, k.tone_shift);
        }
        store_rgb(rgb, out);
    }
}

/* ---- the photo */

/* 16 bytes of each row at a time: five pixels in words, first summed down, then along. */
INLINE half warp_part(const orl_warp_in *in, const uint8_t *p, const int16_t *row, int rows, int narrow, const int16_t *column)
{
    half lo = half_set1(0), hi = lo;
    for (int j = 0; j < rows; j++, p += in->stride) {
        half w = half_set1(row[j]);
        lo = half_add(lo, half_mul(half_pixels(p), w));
        if (!narrow) hi = half_add(hi, half_mul(half_pixels(p + 8), w));
    }
    lo = half_mul(lo, half_load(column));                           /* R0 G0 B0 R1 G1 B1 R2 G2 */
    half sum = half_add(lo, half_down(lo, 3));
    if (narrow) return sum;
    hi = half_mul(hi, half_load(column + 8));                       /* B2 R3 G3 B3 R4 G4 B4 0 */
    return half_add(sum, half_add(half_add(half_down(lo, 6), half_up(hi, 2)), half_add(half_down(hi, 1), half_down(hi, 4))));
}

INLINE void warp_pixel(const orl_warp_in *in, int i, int narrow, uint8_t *rgb, int last)
{
    int u = in->at[i][0], v = in->at[i][1], rows = narrow ? 2 : in->rows;
    const int16_t *column = in->column + (u & 255) * in->parts * 16, *row = in->row + (v & 255) * ORL_WARP_ROWS;
    size_t at = (size_t)(v >> 8) * in->stride + 3 * (size_t)(u >> 8);
    half sum = half_set1(64);
    if (at + (size_t)(rows - 1) * in->stride + (narrow ? 8 : 3 * ORL_WARP_PART * (size_t)in->parts + 1) > in->bytes) {      /* vectors would read on beyond the photo's end */
        orl_warp_in one = *in;
        one.at += i;
        orl_warp_ref(&one, 1, rgb);
        return;
    }
    if (narrow) sum = half_add(sum, warp_part(in, in->photo + at, row, 2, 1, column));
    else for (int k = 0; k < in->parts; k++) sum = half_add(sum, warp_part(in, in->photo + at + 3 * ORL_WARP_PART * k, row, rows, 0, column + 16 * k));
    half_store_rgb(rgb, sum, last);
}

void KERNEL(warp)(const orl_warp_in *in, int n, uint8_t *rgb)
{
    if (in->narrow) for (int i = 0; i < n; i++) warp_pixel(in, i, 1, rgb + 3 * i, i == n - 1);
    else for (int i = 0; i < n; i++) warp_pixel(in, i, 0, rgb + 3 * i, i == n - 1);
}

void KERNEL(mix)(const orl_mix_in *in, int n, uint8_t *rgb)
{
    const int mask = (1 << in->log2) - 1;
    for (int i = 0; i < n; i += LANES, rgb += 3 * LANES) {
        int x = in->x + i + (mask + 1) / 2;
        vec at = and(add(set1(x & mask), lanes()), set1(mask)), ramp = shl_by(add(add(at, at), set1(1)), 14 - in->log2);
        vec layer = share(load_u8(in->layer + i)), w = load_u8(in->weight + i), rest = sub(set1(255), w), r[3], photo[3];
        const int covered = any(w);
        load_rgb(rgb, r);
        if (covered) load_rgb(in->photo + 3 * i, photo);
        for (int c = 0; c < 3; c++) {
            vec sky = between(in->node[c][0], x, in->log2, ramp), stone = between(in->node[c][1], x, in->log2, ramp), l = add(sky, mul(sub(stone, sky), layer));
            r[c] = max(min(add(r[c], sar_by(add(l, set1(16)), 5)), set1(255)), zero());
            if (!covered) continue;
            vec m = add(add(mullo(photo[c], w), mullo(r[c], rest)), set1(128));
            r[c] = shr(add(m, shr(m, 8)), 8);
        }
        store_rgb(rgb, r);
    }
}
