/* The place itself: hall, portico, tower, wing, the square with its town houses and trees, people; and the base colour of every material.
 * x runs along the facade, y into the building, z up, the facade stands at y = 0 and looks towards -y. Included by attraction.c alone. */
#ifndef ATTRACTION_PLACE_H
#define ATTRACTION_PLACE_H
#include "tests/tools/attraction/trace.h"

/* A storey of the front wall: nb bays between x0 and x1 with openings of width w from sill to sill + h (arched: springing there). */
static void storey(set *s, float x0, float x1, float z0, float z1, int nb, float w, float sill, float h, bool arched, bool doors)
{
    float bay = (x1 - x0) / (float)nb;
    for (int i = 0; i < nb; i++) {
        float left = x0 + bay * (float)i, c = left + bay / 2;
        bool door = doors && i == nb / 2;
        float hw = door ? 1.0f : w / 2, foot = door ? z0 : sill, head = door ? z0 + 4.3f : sill + h;
        box(s, STONE, stone, left, c - hw, 0, 0.5f, z0, z1);
        box(s, STONE, stone, c + hw, left + bay, 0, 0.5f, z0, z1);
        if (!door) box(s, STONE, stone, c - hw, c + hw, 0, 0.5f, z0, foot);
        if (arched) arch(s, STONE, stone, 1, c - hw, c + hw, 0, 0.5f, head, z1);
        else box(s, STONE, stone, c - hw, c + hw, 0, 0.5f, head, z1);
        box(s, door ? DOOR : GLASS, door ? wood : glass, c - hw, c + hw, 0.38f, 0.45f, foot, arched ? head + hw : head);
        box(s, TRIM, trim, c - hw - 0.22f, c - hw, -0.10f, 0.1f, foot, head);
        box(s, TRIM, trim, c + hw, c + hw + 0.22f, -0.10f, 0.1f, foot, head);
        if (!door) box(s, TRIM, trim, c - hw - 0.35f, c + hw + 0.35f, -0.22f, 0.1f, foot - 0.2f, foot);
        if (arched) {
            box(s, TRIM, trim, c - hw - 0.26f, c - hw + 0.02f, -0.14f, 0.1f, head - 0.12f, head + 0.1f);
            box(s, TRIM, trim, c + hw - 0.02f, c + hw + 0.26f, -0.14f, 0.1f, head - 0.12f, head + 0.1f);
            box(s, TRIM, trim, c - 0.16f, c + 0.16f, -0.16f, 0.1f, head + hw - 0.05f, head + hw + 0.5f);
        } else {
            box(s, TRIM, trim, c - hw - 0.4f, c + hw + 0.4f, -0.25f, 0.1f, head + 0.12f, head + 0.32f);
            if (i & 1) roof(s, TRIM, trim, 1, -0.25f, 0.1f, c - hw - 0.4f, c + hw + 0.4f, head + 0.32f, head + 0.85f, 0);
            box(s, TRIM, trim, c - hw, c + hw, -0.08f, 0.1f, head, head + 0.12f);
        }
    }
}
static void cornice(set *s, float x0, float x1, float y0, float y1, float z, float size)
{
    box(s, TRIM, trim, x0 - 0.3f * size, x1 + 0.3f * size, y0 - 0.3f * size, y1 + 0.3f * size, z, z + 0.3f * size);
    box(s, TRIM, trim, x0 - 0.8f * size, x1 + 0.8f * size, y0 - 0.8f * size, y1 + 0.8f * size, z + 0.55f * size, z + 0.8f * size);
    box(s, TRIM, trim, x0 - 0.55f * size, x1 + 0.55f * size, y0 - 0.55f * size, y1 + 0.55f * size, z + 0.3f * size, z + 0.55f * size);
}
static void urn(set *s, float x, float y, float z)
{
    box(s, TRIM, trim, x - 0.4f, x + 0.4f, y - 0.4f, y + 0.4f, z, z + 0.7f);
    frustum(s, TRIM, trim, 2, x, y, z + 0.7f, 0.14f, z + 1.0f, 0.12f);
    frustum(s, TRIM, trim, 2, x, y, z + 1.0f, 0.16f, z + 1.6f, 0.46f);
    sphere(s, LEAF, V(0.09f, 0.16f, 0.04f), x, y, z + 1.75f, 0.42f);
}
static void tower_window(set *s, int side, float z, float half, float h)
{
    /* side 0: front, 1: right, 2: left flank, each a proud frame round a dark pane */
    float c = side ? 2.0f : 18.5f, f = side == 0 ? -1.5f : side == 1 ? 22 : 15, out = side == 1 ? 1 : -1;
    for (int i = 0; i < 5; i++) {
        float a0 = i == 1 ? half : -half - (i == 0 ? 0.2f : i > 1 && i < 4 ? 0.3f : 0), a1 = i == 0 ? -half
            : half + (i == 1 ? 0.2f : i > 1 && i < 4 ? 0.3f : 0);
        float z0 = i == 2 ? z - 0.2f : i == 3 ? z + h : z, z1 = i == 2 ? z : i == 3 ? z + h + 0.25f : z + h, deep = i == 4 ? 0.03f : i < 2
            ? 0.14f : 0.24f;
        float n0 = out > 0 ? f - 0.1f : f - deep, n1 = out > 0 ? f + deep : f + 0.1f;
        if (side) box(s, i == 4 ? GLASS : TRIM, i == 4 ? glass : trim, n0, n1, c + a0, c + a1, z0, z1);
        else box(s, i == 4 ? GLASS : TRIM, i == 4 ? glass : trim, c + a0, c + a1, n0, n1, z0, z1);
    }
}
static void build_hall(set *s)
{
    box(s, STONE, stone, -14, 14, 0.5f, 13.5f, 0, 13.2f);
    box(s, TRIM, trim * 0.9f, -14.2f, 14.2f, -0.2f, 13.7f, 0, 1.44f);
    storey(s, -14, 14, 1.44f, 7.2f, 9, 1.3f, 2.5f, 2.9f, false, true);
    storey(s, -14, 14, 7.2f, 12.4f, 9, 1.3f, 8.3f, 2.0f, true, false);
    box(s, TRIM, trim, -14.15f, 14.15f, -0.18f, 13.6f, 7.1f, 7.45f);
    for (int i = 0; i < 46; i++) {                      /* dentils */
        float x = -14 + 28.0f * ((float)i + 0.5f) / 46;
        box(s, TRIM, trim, x - 0.16f, x + 0.16f, -0.36f, 0, 12.1f, 12.4f);
    }
    cornice(s, -14, 14, 0, 13.5f, 12.4f, 0.95f);
    for (int i = 0; i < 56; i++) {                      /* balustrade */
        float x = -14 + 28.0f * ((float)i + 0.5f) / 56;
        if (i % 7 == 3) box(s, TRIM, trim, x - 0.28f, x + 0.28f, -0.3f, 0.25f, 13.1f, 14.25f);
        else frustum(s, TRIM, trim, 2, x, -0.02f, 13.1f, 0.14f, 13.95f, 0.09f);
    }
    box(s, TRIM, trim, -14.1f, 14.1f, -0.25f, 0.2f, 13.9f, 14.12f);
    roof(s, TILE, slate, 0, -13.7f, 13.7f, 0.6f, 13.3f, 13.1f, 17.6f, 6.3f);
    box(s, BRICK, brick, -9.3f, -8.2f, 6, 7, 14, 19), box(s, BRICK, brick, 6.2f, 7.3f, 7, 8, 14, 19);
    for (int side = 0; side < 2; side++)                /* blind windows of the left flank */
        for (int i = 0; i < 3; i++) {
            float y = 2.5f + 4 * (float)i, z = 8.3f;
            box(s, GLASS, glass, -14.03f, -13.9f, y - 0.65f, y + 0.65f, z, z + 2.6f);
            box(s, TRIM, trim, -14.12f, -13.9f, side ? y + 0.65f : y - 0.87f, side ? y + 0.87f : y - 0.65f, z, z + 2.6f);
            box(s, TRIM, trim, -14.25f, -13.9f, y - 1, y + 1, side ? z + 2.6f : z - 0.2f, side ? z + 2.85f : z);
        }
}
static void build_portico(set *s)
{
    box(s, STONE, stone, -8.2f, 8.2f, -5.2f, 0, 0, 1.44f);
    for (int i = 1; i < 8; i++) {
        float front = -5.2f - 0.4f * (float)i;
        box(s, STEP, trim, -7.2f, 7.2f, front, -5.2f, 0, 1.44f - 0.18f * (float)i);
    }
    for (int side = -1; side <= 1; side += 2) {
        float x = 7.7f * (float)side;
        box(s, STONE, stone, x - 0.5f, x + 0.5f, -8.5f, -5.2f, 0, 1.5f);
        box(s, TRIM, trim, x - 0.6f, x + 0.6f, -8.6f, -5.1f, 1.4f, 1.6f);
        urn(s, x, -8.0f, 1.6f);
    }
    for (int i = 0; i < 8; i++) {                       /* six columns in front, two half hidden at the wall */
        float x = i < 6 ? -7 + 2.8f * (float)i : i == 6 ? -7 : 7, y = i < 6 ? -4.2f : -0.5f;
        box(s, TRIM, trim, x - 0.68f, x + 0.68f, y - 0.68f, y + 0.68f, 1.44f, 1.66f);
        frustum(s, MARBLE, marble, 2, x, y, 1.66f, 0.66f, 1.9f, 0.56f);
        frustum(s, MARBLE, marble, 2, x, y, 1.9f, 0.51f, 8.2f, 0.42f);
        frustum(s, MARBLE, marble, 2, x, y, 8.2f, 0.46f, 8.3f, 0.46f);
        frustum(s, MARBLE, marble, 2, x, y, 8.3f, 0.42f, 8.75f, 0.66f);
        box(s, TRIM, trim, x - 0.68f, x + 0.68f, y - 0.68f, y + 0.68f, 8.75f, 8.95f);
    }
    box(s, TRIM, trim, -7.75f, 7.75f, -4.8f, 0.3f, 8.95f, 9.55f);
    box(s, STONE, stone, -7.65f, 7.65f, -4.7f, 0.3f, 9.55f, 10.25f);
    for (int i = 0; i < 27; i++) {
        float x = -7.5f + 15.0f * ((float)i + 0.5f) / 27;
        box(s, TRIM, trim, x - 0.15f, x + 0.15f, -4.95f, -4.6f, 10.0f, 10.25f);
    }
    box(s, TRIM, trim, -8.3f, 8.3f, -5.3f, 0.3f, 10.25f, 10.55f);
    roof(s, STONE, stone, 1, -4.6f, 0.6f, -8.0f, 8.0f, 10.55f, 13.6f, 0);
    beam(s, TRIM, trim, -8.5f, 10.85f, 0, 14.1f, 0.42f, -5.35f, -4.3f), beam(s, TRIM, trim, 0, 14.1f, 8.5f, 10.85f, 0.42f, -5.35f, -4.3f);
    beam(s, TILE, slate, -8.4f, 10.9f, 0, 14.0f, 0.3f, -4.3f, 1), beam(s, TILE, slate, 0, 14.0f, 8.4f, 10.9f, 0.3f, -4.3f, 1);
    frustum(s, TRIM, trim, 1, 11.95f, 0, -4.75f, 0.95f, -4.5f, 0.95f);
    frustum(s, CLOCK, trim, 1, 11.95f, 0, -4.85f, 0.7f, -4.6f, 0.7f);
    for (int i = 0; i < 3; i++) urn(s, i == 1 ? 0 : i ? 8.1f : -8.1f, -4.9f, i == 1 ? 13.95f : 10.75f);
}
static void build_tower(set *s)
{
    box(s, BRICK, brick, 15, 22, -1.5f, 5.5f, 0, 20);
    box(s, STONE, stone, 14.85f, 22.15f, -1.65f, 5.65f, 0, 2.8f);
    box(s, TRIM, trim, 14.75f, 22.25f, -1.75f, 5.75f, 2.8f, 3.1f);
    box(s, STONE, stone, 13.9f, 15.1f, 0.4f, 5, 0, 12.4f);
    for (int i = 0; i < 2; i++) box(s, TRIM, trim, 14.8f, 22.2f, -1.7f, 5.7f, i ? 14.0f : 8.0f, i ? 14.4f : 8.4f);
    for (int i = 0; i < 28; i++)                        /* quoins */
        for (int corner = 0; corner < 4; corner++) {
            float z = 3.1f + 0.6f * (float)i, longer = (i + corner) & 1 ? 0.75f : 0.45f, other = 1.2f - longer;
            float x0 = corner & 1 ? 22.06f - longer : 14.94f, y0 = corner & 2 ? 5.56f - other : -1.56f;
            box(s, TRIM, trim * (0.9f + 0.1f * hash01(i, corner, 5)), x0, x0 + longer, y0, y0 + other, z, z + 0.57f);
        }
    for (int side = 0; side < 3; side++) {
        tower_window(s, side, 4.6f, 0.5f, 2.2f), tower_window(s, side, 10.2f, 0.6f, 2.4f);
        int axis = side ? 0 : 1;
        float at = side == 0 ? -1.5f : side == 1 ? 22 : 15, out = side == 1 ? 1 : -1;
        float cu = side ? 2 : 17.1f, cv = side ? 17.1f : 18.5f;     /* axis y: z then x; axis x: y then z */
        frustum(s, TRIM, trim, axis, cu, cv, fminf(at, at + 0.22f * out), 1.75f, fmaxf(at, at + 0.22f * out), 1.75f);
        frustum(s, CLOCK, trim, axis, cu, cv, fminf(at, at + 0.3f * out), 1.45f, fmaxf(at, at + 0.3f * out), 1.45f);
    }
    cornice(s, 15, 22, -1.5f, 5.5f, 19.7f, 0.9f);
    for (int corner = 0; corner < 4; corner++) {        /* belfry */
        float x0 = corner & 1 ? 20.1f : 15, y0 = corner & 2 ? 3.6f : -1.5f;
        box(s, STONE, stone, x0, x0 + 1.9f, y0, y0 + 1.9f, 20.4f, 25);
        box(s, TRIM, trim, x0 - 0.08f, x0 + 1.98f, y0 - 0.08f, y0 + 1.98f, 22.9f, 23.1f);
    }
    for (int side = 0; side < 2; side++) {
        float y0 = side ? 4.7f : -1.5f, x0 = side ? 21.2f : 15;
        arch(s, STONE, stone, 1, 16.9f, 20.1f, y0, y0 + 0.8f, 23, 25), box(s, STONE, stone, 16.9f, 20.1f, y0, y0 + 0.8f, 20.4f, 21.3f);
        arch(s, STONE, stone, 0, x0, x0 + 0.8f, 0.4f, 3.6f, 23, 25), box(s, STONE, stone, x0, x0 + 0.8f, 0.4f, 3.6f, 20.4f, 21.3f);
    }
    frustum(s, PLAIN, V(0.20f, 0.13f, 0.06f), 2, 18.5f, 2, 22.0f, 1.0f, 23.6f, 0.5f);
    frustum(s, PLAIN, iron, 2, 18.5f, 2, 23.6f, 0.12f, 25, 0.12f);
    cornice(s, 15, 22, -1.5f, 5.5f, 25, 0.9f);
    frustum(s, STONE, stone, 2, 18.5f, 2, 25.7f, 3.3f, 28.2f, 3.2f);
    frustum(s, TRIM, trim, 2, 18.5f, 2, 28.0f, 3.45f, 28.3f, 3.45f);
    sphere(s, COPPER, copper, 18.5f, 2, 28.4f, 3.1f);
    frustum(s, TRIM, trim, 2, 18.5f, 2, 31.2f, 0.95f, 31.5f, 0.95f);
    frustum(s, STONE, stone, 2, 18.5f, 2, 31.4f, 0.7f, 33.0f, 0.65f);
    frustum(s, COPPER, copper, 2, 18.5f, 2, 33.0f, 0.95f, 35.0f, 0.05f);
    sphere(s, PLAIN, V(0.55f, 0.40f, 0.10f), 18.5f, 2, 35.1f, 0.25f);
}
static void build_wing(set *s)
{
    const v3 plaster = { 0.62f, 0.47f, 0.27f, 0 };
    box(s, PLASTER, plaster, -31, -14, 3.8f, 9, 0, 5.2f);
    box(s, BRICK, brick, -31, -30.5f, 1, 3.8f, 0, 5.2f);
    for (int i = 0; i < 6; i++) {
        float left = -31 + 17.0f / 6 * (float)i, c = left + 17.0f / 12, right = left + 17.0f / 6;
        box(s, BRICK, brick, left, c - 1, 1, 1.5f, 0, 4.2f), box(s, BRICK, brick, c + 1, right, 1, 1.5f, 0, 4.2f);
        arch(s, BRICK, brick, 1, c - 1, c + 1, 1, 1.5f, 2.6f, 4.2f);
        for (int k = -1; k <= 1; k += 2) box(s, TRIM, trim, c + (float)k * 1.2f - 0.24f, c + (float)k * 1.2f + 0.24f, 0.9f, 1.6f, 2.45f,
            2.65f);
        box(s, TRIM, trim, c - 0.15f, c + 0.15f, 0.88f, 1.6f, 3.5f, 4.1f);
        box(s, i % 3 == 1 ? DOOR : GLASS, i % 3 == 1 ? wood : glass, c - 0.7f, c + 0.7f, 3.72f, 3.9f, i % 3 == 1 ? 0.1f : 1, 3.0f);
    }
    box(s, BRICK, brick, -31, -14, 1, 1.5f, 4.2f, 5.2f);
    box(s, TRIM, trim, -31.1f, -14, 0.88f, 9.1f, 4.25f, 4.4f);
    box(s, TRIM, trim, -31.3f, -14, 0.7f, 9.3f, 5.0f, 5.3f);
    roof(s, TILE, tile, 0, -31.5f, -14, 0.5f, 9.5f, 5.3f, 8.2f, 0);
    box(s, BRICK, brick, -27.5f, -26.7f, 6.2f, 7, 6, 9.6f), box(s, BRICK, brick, -19, -18.2f, 6.2f, 7, 6, 9.6f);
}
static void tree(set *s, rng *r, float x, float y, float size)
{
    frustum(s, PLAIN, V(0.10f, 0.07f, 0.045f), 2, x, y, 0, 0.10f * size, 1.6f * size, 0.06f * size);
    sphere(s, LEAF, V(0.10f, 0.17f, 0.045f), x, y, 2.6f * size, 0.9f * size);
    for (int i = 0; i < 15; i++) {
        v3 at = uniform3(r, V(0, 1.7f, 0.24f), V(2 * PI, 3.7f, 0.8f)), look = uniform3(r, V(0.36f, 0.75f, 0), V(0.62f, 1.2f, 0));
        float out = at[2] * (1.25f - 0.45f * fabsf(at[1] - 2.5f)) * size;
        sphere(s, LEAF, V(0.10f, 0.17f, 0.045f) * look[1], x + out * cosf(at[0]), y + out * sinf(at[0]), at[1] * size, look[0] * size);
    }
}
static void build_square(set *s)
{
    rng r = rng_make(20, 7);
    static const float plaster[6][3] = { { 0.60f, 0.50f, 0.34f }, { 0.56f, 0.36f, 0.24f }, { 0.62f, 0.58f, 0.50f }, { 0.45f, 0.46f, 0.42f },
        { 0.60f, 0.44f, 0.36f }, { 0.50f, 0.42f, 0.26f } };
    for (int row = 0; row < 3; row++)                   /* town houses behind and on both sides */
        for (float at = row ? -46 : -84; at < (row ? 44 : 84);) {
            float wide = uniform(&r, 7, 12), tall = uniform(&r, 7.5f, 13), z1 = tall + uniform(&r, 2, 4);
            const float *c = plaster[rng_next(&r) % 6];
            v3 tint = V(c[0], c[1], c[2]) * uniform(&r, 0.85f, 1), top = rng_next(&r) & 1 ? tile : slate;
            float x0 = row == 0 ? at : row == 1 ? -74 : 60, x1 = row == 0 ? at + wide : row == 1 ? -60 : 74, y0 = row == 0 ? 38 : at,
                y1 = row == 0 ? 50 : at + wide;
            box(s, HOUSE, tint, x0, x1, y0, y1, 0, tall);
            roof(s, TILE, top, row ? 1 : 0, row ? y0 : x0, row ? y1 : x1, (row ? x0 : y0) - 0.5f, (row ? x1 : y1) + 0.5f, tall, z1, 0);
            if (rng_next(&r) & 1) box(s, BRICK, brick, x0 + 2, x0 + 2.9f, y0 + 3, y0 + 3.9f, tall, z1 + 1);
            at += wide;
        }
    for (int i = 0; i < 5; i++) sphere(s, LEAF, V(0.16f, 0.20f, 0.12f), -260 + 130.0f * (float)i, 330 + 25 * (float)(i & 1), -150,
        185 + 8 * (float)(i % 3));
    for (int i = 0; i < 14; i++) {
        v3 at = uniform3(&r, V(i < 7 ? -44 : 38, i % 7 * 8 - 23, 1.7f), V(i < 7 ? -40 : 42, i % 7 * 8 - 21, 2.4f));
        tree(s, &r, at[0], at[1], at[2]);
    }
    tree(s, &r, 26.5f, 1, 1.9f), tree(s, &r, 30, 7, 2.2f), tree(s, &r, -35, 5, 2.0f);
    for (int i = -1; i <= 1; i += 2) {                  /* lamp posts */
        float x = 12.5f * (float)i, y = -9;
        frustum(s, PLAIN, iron, 2, x, y, 0, 0.2f, 0.6f, 0.12f), frustum(s, PLAIN, iron, 2, x, y, 0.6f, 0.08f, 4.2f, 0.06f);
        sphere(s, PLAIN, V(0.7f, 0.68f, 0.6f), x, y, 4.45f, 0.3f), frustum(s, PLAIN, iron, 2, x, y, 4.68f, 0.2f, 4.9f, 0.04f);
    }
}
static void build_place(set *s)
{
    build_hall(s), build_portico(s), build_tower(s), build_wing(s), build_square(s);
    set_build(s);
}
/* Somebody standing or walking: heading in radians, phase of the step. */
static void person(set *s, rng *r, float x, float y, float heading, float phase)
{
    float k = uniform(r, 0.92f, 1.08f), stride = 0.32f * sinf(phase), turn = heading;
    v3 along = V(cosf(turn), sinf(turn), 0), side = V(-sinf(turn), cosf(turn), 0), at = V(x, y, 0), up = V(0, 0, k);
    v3 coat = uniform3(r, V(0.03f, 0.03f, 0.03f), V(0.7f, 0.6f, 0.6f)), legs = V(0.05f, 0.06f, 0.10f) * uniform(r, 0.5f, 4);
    v3 skin = V(0.55f, 0.36f, 0.26f) * uniform(r, 0.35f, 1), hair = V(0.12f, 0.08f, 0.05f) * uniform(r, 0.2f, 3);
    for (int i = -1; i <= 1; i += 2) {
        float f = (float)i;
        capsule(s, legs, at + side * (0.09f * f) + up * 0.85f, at + side * (0.10f * f) + along * (stride * f) + up * 0.08f, 0.085f * k);
        capsule(s, coat, at + side * (0.21f * f) + up * 1.38f, at + side * (0.27f * f) - along * (0.7f * stride * f) + up * 0.85f,
            0.055f * k);
        sphere(s, PLAIN, skin, at[0] + (0.27f * f) * side[0] - 0.7f * stride * f * along[0],
            at[1] + (0.27f * f) * side[1] - 0.7f * stride * f * along[1], 0.80f * k, 0.06f);
    }
    capsule(s, coat, at + up * 0.92f, at + up * 1.33f, 0.17f * k);
    capsule(s, coat, at + side * 0.12f + up * 1.38f, at - side * 0.12f + up * 1.38f, 0.09f * k);
    sphere(s, PLAIN, skin, x, y, 1.62f * k, 0.115f * k);
    sphere(s, PLAIN, hair, x - 0.03f * along[0], y - 0.03f * along[1], 1.655f * k, 0.118f * k);
}

/* ---- base colour ---- */
/* Share of a footprint fp around x that lines of half width `half`, `period` apart, cover. */
static float lines(float x, float period, float half, float fp)
{
    float d = fabsf(x - period * roundf(x / period));
    fp = clampf(fp, 1e-4f, period);
    return clampf((fminf(d + fp / 2, half) - fmaxf(d - fp / 2, -half)) / fp, 0, 1);
}
static float fade(float size, float fp) { return clampf(2 * size / fp - 1, 0, 1); }    /* detail of a size vanishes under a footprint */
/* Courses of blocks: joint cover, and a random value of the block in -1..1 that fades with distance. */
static float blocks(float u, float v, float bw, float bh, float joint, float fp, int salt, float *vary)
{
    int row = (int)floorf(v / bh);
    u += (float)(row & 1) * bw / 2;
    *vary = (2 * hash01((int)floorf(u / bw), row, salt) - 1) * fade(bh, fp);
    float a = lines(u, bw, joint, fp), b = lines(v, bh, joint, fp);
    return a + b - a * b;
}
static v3 base_colour(const prim *q, v3 p, v3 n, float fp)
{
    float horizontal = sqrtf(n[0] * n[0] + n[1] * n[1]), u = p[0], v = p[1], vary, j;
    int m = q ? q->material : PAVE;
    v3 c = q ? q->tint : pave_tint;
    if (q && q->kind == FRUSTUM && q->axis == 2 && horizontal > 0.2f)
        u = atan2f(p[1] - q->a[1], p[0] - q->a[0]) * (q->b[0] + q->b[1]) / 2, v = p[2];
    else if (horizontal > 0.3f) u = (p[1] * n[0] - p[0] * n[1]) / horizontal, v = p[2] / horizontal;
    float grime = fbm(p[0] * 0.35f, p[1] * 0.35f, p[2] * 0.35f, 3) - 0.44f;
    float streak = horizontal > 0.5f ? noise(u * 1.7f, v * 0.22f, 3) - 0.5f : 0;
    float grain = (noise(p[0] * 5, p[1] * 5, p[2] * 5) - 0.5f) * fade(0.15f, fp);
    switch (m) {
    case STONE:
        j = blocks(u, v, 1.05f, 0.46f, 0.022f, fp, 1, &vary);
        c = c * (1 + 0.15f * vary + 0.42f * grime + 0.22f * streak + 0.25f * grain) * (1 - 0.55f * j);
        c = c * V(1 + 0.05f * vary, 1, 1 - 0.10f * vary);
        break;
    case STEP: c = c * (n[2] > 0.5f ? 1.05f : 0.72f);       /* worn treads, dark risers */ /* fall through */
    case TRIM: c = c * (1 + 0.55f * grime + 0.28f * streak + 0.2f * grain); break;
    case MARBLE: {
        float flute = 0.5f + 0.5f * cosf(40 * PI * u / (PI * 0.95f));
        c = c * (1 - 0.25f * flute * fade(0.07f, fp)) * (1 - 0.5f * lines(v, 1.27f, 0.02f, fp)) * (1 + 0.6f * grime + 0.2f * streak);
        break;
    }
    case BRICK:
        j = blocks(u, v, 0.48f, 0.17f, 0.014f, fp, 2, &vary);
        c = mix(c * (1 + 0.45f * vary + 0.7f * grime + 0.25f * streak), V(0.42f, 0.37f, 0.31f), 0.8f * j);
        c = c * (1 + 0.30f * (hash01((int)floorf(u / 1.44f), (int)floorf(v / 0.51f), 8) - 0.5f) * fade(0.5f, fp));
        break;
    case TILE:
        j = blocks(u, v, 0.42f, 0.36f, 0.035f, fp, 3, &vary);
        c = c * (1 + 0.42f * vary + 0.9f * grime + 0.3f * grain) * (1 - 0.5f * j);
        break;
    case PAVE: {
        float band = fmaxf(lines(u - 2.4f, 9.6f, 0.42f, fp), lines(v - 2.4f, 9.6f, 0.42f, fp));
        j = blocks(u, v, 1.2f, 0.8f, 0.025f, fp, 4, &vary);
        float spot = (fbm(p[0] * 0.08f, p[1] * 0.08f, 9, 3) - 0.44f) * 0.9f;
        c = mix(c * (1 + 0.24f * vary + 0.5f * grime + spot + 0.3f * grain), V(0.52f, 0.47f, 0.39f) * (1 + 0.4f * grime),
            band) * (1 - 0.5f * j * (1 - band));
        break;
    }
    case GLASS: case DOOR: {
        bool facing_y = fabsf(n[1]) > 0.5f;
        float w = facing_y ? q->hi[0] - q->lo[0] : q->hi[1] - q->lo[1], h = q->hi[2] - q->lo[2];
        float a = facing_y ? p[0] - q->lo[0] : p[1] - q->lo[1], b = p[2] - q->lo[2];
        float bar = fmaxf(lines(a, w / 2, 0.045f, fp), lines(b, h / 4, 0.04f, fp));
        if (m == DOOR) c = c * (1 + 0.5f * grain + 0.2f * streak) * (1 - 0.6f * bar) + V(0.10f, 0.045f, 0.02f) * lines(a - w / 4, w / 2,
            0.22f, fp);
        else c = mix(c * (0.6f + 1.2f * hash01((int)(a * 2 / w), (int)(b * 4 / h), q->id)), V(0.46f, 0.43f, 0.37f), bar);
        break;
    }
    case COPPER: {
        float turn = atan2f(p[1] - 2, p[0] - 18.5f);
        c = c * (1 - 0.4f * lines(turn, PI / 12, 0.025f, fp / 3)) * (1 + 0.9f * grime + 0.35f * (noise(turn * 9, p[2] * 0.5f, 4) - 0.5f));
        break;
    }
    case PLASTER: c = c * (1 + 0.6f * grime + 0.3f * streak + 0.1f * grain); break;
    case HOUSE: {
        float a = lines(u - 1.2f, 2.4f, 0.52f, fp), b = lines(v - 1.9f, 3.1f, 0.8f, fp),
            frame = lines(u - 1.2f, 2.4f, 0.68f, fp) * lines(v - 1.9f, 3.1f, 0.96f, fp);
        c = mix(mix(c * (1 + 0.5f * grime + 0.3f * streak), V(0.62f, 0.58f, 0.5f), frame), V(0.06f, 0.07f, 0.08f), a * b);
        if (p[2] < 0.9f) c = c * 0.6f;
        break;
    }
    case LEAF: c = c * (0.15f + 1.8f * fbm(p[0] * 2.3f, p[1] * 2.3f, p[2] * 2.3f, 3) + 1.2f * grain); break;
    case CLOCK: {                                       /* hours around the rim, two hands */
        float du = q->axis == 1 ? p[0] - q->a[1] : p[1] - q->a[0], dz = q->axis == 1 ? p[2] - q->a[0] : p[2] - q->a[1],
            r = sqrtf(du * du + dz * dz) / q->b[0];
        float turn = atan2f(du, dz), mark = r > 0.7f && r < 0.92f ? lines(turn, PI / 6, 0.07f, fp) : 0;
        float hand = fmaxf(fabsf(du + dz * 0.2f) < 0.07f && dz > -0.1f && r < 0.85f, fabsf(dz - du * 0.55f) < 0.08f && du > -0.1f &&
            r < 0.55f);
        c = mix(V(0.72f, 0.70f, 0.63f), V(0.04f, 0.04f, 0.05f), fmaxf(fmaxf(mark, hand), r > 0.95f));
        break;
    }
    default: break;
    }
    for (int i = 0; i < 3; i++) c[i] = clampf(c[i], 0.015f, 0.85f);
    return c;
}
#endif
