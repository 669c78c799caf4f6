/* The scene file (formats/SCENE.md) in memory. Read: the surface is unpacked into a block that is allocated when the file is opened, other pointers go into the mapped file, and the light model is copied.
 * Written: the trainer fills the same struct.
 *
 * Grid frame: the scene frame (z up) scaled and moved so that one unit is one fine cell and the box is [0, 8 nb_x] x [0, 8 nb_y] x [0, 8 nb_z].
 *   grid = S * world + o, S = scale * rotation (row-major world_to_grid, 3 x 4).
 * Bricks: 8^3 cells, 9^3 vertices each (the upper faces repeat the neighbour's vertices), vertex index = x + 9 (y + 9 z). */
#ifndef ORIEL_SCENE_H
#define ORIEL_SCENE_H
#include <stddef.h>
#include <stdint.h>
#include "oriel/backdrop.h"
#include "oriel/facing.h"
#include "oriel/light.h"
#include "oriel/skin.h"

enum { ORL_GROUND_SIDE = 96, ORL_VIEWS = 2, ORL_CUTS = 16 };      /* CUTS: sections of the solid that a ray passes through at most */
#define ORL_GROUND_FALL 1e-3f   /* least slope at which a ray falls on the ground */
#define ORL_GROUND_FAR 1e5f     /* cells */
#define ORL_GROUND_CUT 0.02f    /* of the box's side along x: a cut no higher over the plane is the ground's, a higher one is passed through */
#define ORL_SUN_LIFT 1.5f       /* cells over a surface at which rays to the sun begin: what it is rough by */
#define ORL_GROUND_EYE 0.015f   /* least height of an eye over the ground, of the box's side along x: land is not as flat as a plane, and nobody's eye is under it */
enum { ORL_BRICK = 8, ORL_BRICK_V = 9, ORL_BRICK_VERTS = 729, ORL_LITE_V = 3, ORL_LITE_VERTS = 27, ORL_LITE_BYTES = 17 };
#define ORL_SDF_UNIT 32         /* sdf int8 is in 1/32 cell, saturating: -4 .. +3.97 cells; positive = free space */

enum { ORL_BRICKS_MOST = 1 << 20 };
/* What is packed by rounding, and how coarsely (SCENE.md 5.3): steps in units of the stored byte, 0 counting as 1, which loses nothing. */
enum { ORL_PACK_SDF, ORL_PACK_ALBEDO, ORL_PACK_LITE, ORL_PACK_SHADOW, ORL_PACK_GROUND, ORL_PACK_BACK, ORL_PACKED };
typedef struct {
    uint8_t step[2];                /* of distances, green, openness, shadow features, opacity; and of red and blue, horizons */
    uint8_t far;                    /* of distances: the step grows by so many 1024ths of itself for each 1/32 cell from the surface */
} orl_pack_step;

typedef struct {
    uint32_t nb[3];                 /* bricks along x, y, z; 1..512 each, product <= 2^24 */
    double world_to_grid[12];       /* row-major 3 x 4 similarity */
    float cell_world;               /* world units per fine cell */
    uint32_t nbricks;               /* at most ORL_BRICKS_MOST */
    const int32_t *bmap;            /* [nb_z][nb_y][nb_x]: >= 0 brick index, rising by one from 0; < 0: empty, -d = Chebyshev distance in bricks to the nearest brick, -127 at most */
    const int8_t *sdf;              /* [nbricks][729], two bytes behind which may be read */
    uint32_t ntextures;
    const uint32_t *skin;           /* [nbricks]: first texture << 6 | faces (oriel/skin.h), at least one; bricks take their textures in turn */
    const uint8_t *albedo;          /* [ntextures][17 x 17][3]: linear albedo = (v / 255)^2 */
    const uint8_t *lite;            /* [nbricks][27][17]: openness (v / 255), then 16 horizon elevations (v / 255 * pi / 2) at vertices 4 cells apart; NULL: open = 1, horizon = 0 */
    const int8_t *shadow;           /* [nbricks][27][8]: phi_k = v * shadow_scale[k] at the same vertices; NULL: no shadow branch */
    float shadow_scale[ORL_SHADOW_DIM];     /* powers of two */
    float ground[3];                /* z = ground[0] + ground[1] x + ground[2] y, cells: what rays that meet no brick fall on */
    const uint8_t *ground_albedo;   /* [96][96][3], y outer: linear albedo = (v / 255)^2 over [-8 nb, 16 nb] along x and y, edges go on; NULL: no ground */
    orl_backdrop backdrop;
    const uint8_t *backdrop_rgba;   /* [ROWS][COLS][4]: linear albedo = (v / 255)^2 and opacity; NULL: no backdrop */
    orl_facings facings;            /* towards which normals are turned (orl_facing_turn); decoded from int16 */
    orl_light_model light;          /* decoded from int16 with power-of-two scales */
    uint32_t ncodes;                /* codes of training photos, starts for adaptation; may be 0 */
    const float *codes;             /* [ncodes][ORL_CODE] */
    const uint8_t *view[ORL_VIEWS]; uint64_t view_bytes[ORL_VIEWS];    /* of a baked file, which has no surface: the photo's view and the wide one (runtime/baked.h); NULL, 0 */
    char title[64];                 /* e.g. the SCENE folder's name */
    orl_pack_step step[ORL_PACKED]; /* how coarsely it was, or is to be, written; what is read is written again to the same bytes */
    /* writer's side */
    const uint8_t *texel_used, *light_used;     /* [ntextures][17 x 17], [nbricks][27]: 0 where nothing looks, and the writer may put what it likes; NULL: all count */
    /* owner's side */
    void *map; size_t map_bytes;    /* mapped file, or NULL when the arrays belong to the writer */
    void *block[2];                 /* what was unpacked, or NULL */
} orl_scene;

/* Maps, unpacks and validates the file: parse (sections, checksums, every count against remaining bytes), unpack, then validate (ranges, finite numbers). Unpacking takes one thread per core; the same for any number. */
orl_err orl_scene_open(const char *path, orl_scene *out);
/* The same from memory (not owned, 64-byte aligned, needed until the scene is closed), for fuzzing. name stands in messages. */
orl_err orl_scene_parse(const void *bytes, size_t n, const char *name, orl_scene *out);
void orl_scene_close(orl_scene *s);
/* Temporary file, fsync, rename. Vertices and texels that bricks share are those of the first that has them. write -> read -> write is byte-identical. */
orl_err orl_scene_write(const char *path, const orl_scene *s, size_t *bytes_out);
/* Bytes that it would take; path stands in messages. */
orl_err orl_scene_size(const char *path, const orl_scene *s, size_t *bytes_out);
/* Section list for `oriel info`. */
typedef struct { char tag[5]; uint64_t offset, bytes; uint32_t crc; } orl_scene_section;
orl_err orl_scene_sections(const char *path, orl_scene_section *out, int cap, int *count);
#endif
