/* Packed sections of a scene (formats/SCENE.md 5): what stands on lattices of vertices or texels, and which bricks and textures there are, through a binary range coder.
 * Integers alone: what is unpacked is the same on every machine. Bytes that are read are not trusted: nothing is read or written out of bounds, and work ends where the bytes do. */
#ifndef FORMATS_PACK_H
#define FORMATS_PACK_H
#include "oriel/scene.h"

enum { PACK_HEAD = 8 };         /* bytes before a lattice's stream: its steps [5.3] */

/* Both give malloc'd bytes. The map's bricks must be numbered in its order; pack_values takes bmap, nb, nbricks, skin and steps of s, and rounds values by the steps. used, by vertex, or NULL: 0 where no value matters. */
orl_err pack_index(const orl_scene *s, uint8_t **map, size_t *map_bytes, uint8_t **skin, size_t *skin_bytes);
orl_err pack_values(int kind, const orl_scene *s, const void *values, const uint8_t *used, uint8_t **bytes, size_t *n);

/* Bricks and their distances into bmap, textures into skin, from nb and nbricks of s; *textures: how many. name stands in messages. */
orl_err unpack_index(const orl_scene *s, const uint8_t *map, size_t map_bytes, const uint8_t *skin_from, size_t skin_bytes, const char *name, int32_t *bmap, uint32_t *skin, uint32_t *textures);
/* Values of a kind (ORL_PACK_..) from bmap, nb, nbricks and skin of s, and the steps that they were rounded by. ORL_E_FORMAT without a text: the stream does not end where the bytes do, or its head is none. */
orl_err unpack_values(int kind, const orl_scene *s, const uint8_t *bytes, size_t n, void *values, orl_pack_step *step);
/* Bytes of the values, from nbricks and ntextures of s. */
uint64_t pack_bytes(int kind, const orl_scene *s);
#endif
