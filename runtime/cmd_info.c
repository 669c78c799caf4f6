/* `oriel info`: what is in a scene file. */
#include <inttypes.h>
#include <stdio.h>
#include "oriel/scene.h"
#include "runtime/baked.h"
#include "runtime/commands.h"

static const char HELP[] =
    "Usage: oriel info [--json] SCENE_FILE\nWhat is in a scene file, or a baked one: sections with their bytes, extent, bricks, dimensions in use.\n\n"
    "  --json   one JSON object\n  --help   this text\n";

static int any(const float *v, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (v[i] != 0) return 1;
    return 0;
}

int orl_cmd_info(int argc, char **argv)
{
    static const struct option TABLE[] = { { "json", no_argument, NULL, 'j' }, { "help", no_argument, NULL, 'h' }, { 0 } };
    int json = 0, first = 1;
    for (int c; (c = orl_option_next(argc, argv, TABLE, &first)) != -1; ) {
        if (c == 'j') json = 1;
        else if (c == 'h') return printf("%s", HELP) < 0;
        else return ORL_EXIT_USAGE;
    }
    if (argc - optind != 1) {
        orl_fail(ORL_E_RANGE, "one scene file is wanted");
        return ORL_EXIT_USAGE;
    }
    const char *path = argv[optind];
    enum { CAP = 64 };
    orl_scene_section part[CAP];
    orl_scene s;
    int n = 0, env = 0, own = 0, shadow = 0;
    if (orl_scene_open(path, &s)) return ORL_EXIT_FAILED;
    if (orl_scene_sections(path, part, CAP, &n)) {
        orl_scene_close(&s);
        return ORL_EXIT_FAILED;
    }
    orl_view view[ORL_VIEWS];
    orl_camera photo;
    if (s.view[0] && orl_baked_views(&s, path, view, &photo)) {
        orl_scene_close(&s);
        return ORL_EXIT_FAILED;
    }
    const orl_light_model *m = &s.light;
    for (int k = 0; k < ORL_ENV_DIM; k++) env += any(&m->env_basis[k][0][0], ORL_ENV * 3);
    for (int k = ORL_SKY_Q - ORL_SKY_DIM; k < ORL_SKY_Q; k++) own += any(&m->sky_gen[k][0][0], 3 * ORL_SKY_Y);
    for (int k = 0; s.shadow && k < ORL_SHADOW_DIM; k++) shadow += s.shadow_scale[k] != 0;
    const double *g = s.world_to_grid;
    double size[3] = { 8 * (double)s.cell_world * s.nb[0], 8 * (double)s.cell_world * s.nb[1], 8 * (double)s.cell_world * s.nb[2] };
    uint64_t total = (uint64_t)s.nb[0] * s.nb[1] * s.nb[2];
    if (json) {
        printf("{\"file\": ");
        orl_json_string(path);
        printf(", \"title\": ");
        orl_json_string(s.title);
        printf(", \"bytes\": %zu, \"sections\": [", s.map_bytes);
        for (int i = 0; i < n; i++) {
            printf("%s{\"tag\": ", i ? ", " : "");
            orl_json_string(part[i].tag);
            printf(", \"offset\": %" PRIu64 ", \"bytes\": %" PRIu64 ", \"crc\": %" PRIu32 "}", part[i].offset, part[i].bytes, part[i].crc);
        }
        printf("], \"grid\": [%u, %u, %u], \"cell_world\": %.9g, \"bricks\": %u, \"textures\": %u, \"horizon\": %s, \"facings\": %d, \"backdrop\": %.9g, \"shadow_dims\": %d, \"env_dims\": %d, \"sky_dims\": %d, \"codes\": %u, \"world_to_grid\": [",
               s.nb[0] * 8, s.nb[1] * 8, s.nb[2] * 8, (double)s.cell_world, s.nbricks, s.ntextures, s.lite ? "true" : "false", s.facings.n, (double)s.backdrop.half[0] / (4.0 * (s.nb[0] ? s.nb[0] : 1)), shadow, env, own, s.ncodes);
        for (int i = 0; i < 12; i++) printf("%s%.17g", i ? ", " : "", g[i]);
        printf("]");
        if (s.view[0]) printf(", \"photo\": [%d, %d], \"views\": [[%d, %d], [%d, %d]]", photo.w, photo.h, view[0].w, view[0].h, view[1].w, view[1].h);
        printf("}\n");
    } else {
        printf("%s: %.64s, %zu bytes\n", path, s.title, s.map_bytes);
        for (int i = 0; i < n; i++) printf("  %-4s  %10" PRIu64 " bytes at %10" PRIu64 "  crc %08" PRIx32 "\n", part[i].tag, part[i].bytes, part[i].offset, part[i].crc);
        if (total) printf("grid      %u x %u x %u cells of %.6g, box %.5g x %.5g x %.5g world units\n", s.nb[0] * 8, s.nb[1] * 8, s.nb[2] * 8, (double)s.cell_world, size[0], size[1], size[2]);
        if (total) printf("bricks    %u of %" PRIu64 " (%.1f %%)\n", s.nbricks, total, 100.0 * s.nbricks / (double)total);
        if (total) printf("textures  %u of base colour, %d texels a cell, %.2f a brick\n", s.ntextures, ORL_SKIN_PER_CELL, s.ntextures / (double)(s.nbricks + !s.nbricks));
        if (total) printf("packed    in steps of %d (distances), %d and %d (base colour), %d and %d (light), %d (shadow features)\n", s.step[ORL_PACK_SDF].step[0], s.step[ORL_PACK_ALBEDO].step[0], s.step[ORL_PACK_ALBEDO].step[1],
                          s.step[ORL_PACK_LITE].step[0], s.step[ORL_PACK_LITE].step[1], s.step[ORL_PACK_SHADOW].step[0]);
        if (s.facings.n) printf("facings   %d directions that walls have\n", s.facings.n);
        if (s.backdrop_rgba) printf("backdrop  on walls %.3g times as far away as the box's\n", (double)s.backdrop.half[0] / (4.0 * s.nb[0]));
        if (s.view[0]) printf("baked     a photo of %d x %d, its light found in %d x %d, widened to %d x %d\n", photo.w, photo.h, view[0].w, view[0].h, view[1].w, view[1].h);
        printf("light     %d of %d environment dimensions, %d of %d of the sky's own", env, ORL_ENV_DIM, own, ORL_SKY_DIM);
        if (total) printf(", %s, %d of %d shadow features", s.lite ? "openness and horizons" : "no horizons", shadow, ORL_SHADOW_DIM);
        printf("\n");
        printf("codes     %u training photos\n", s.ncodes);
    }
    orl_scene_close(&s);
    return ORL_EXIT_DONE;
}
